#pragma once
#define PARAM_UINT8 1
#define PARAM_FLOAT 6
#define PARAM_GROUP_START(name) static const struct { int type; void *value; } param_##name[] = {
#define PARAM_ADD(kind, name, address) {kind, address},
#define PARAM_GROUP_STOP(name) }; const void *const param_group_##name = param_##name;
