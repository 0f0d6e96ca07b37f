#pragma once
#include <stdint.h>
typedef uint16_t logVarId_t;
logVarId_t logGetVarId(const char *group, const char *name);
float logGetFloat(logVarId_t variable);
#define LOG_UINT8 1
#define LOG_UINT16 2
#define LOG_FLOAT 7
#define LOG_GROUP_START(name) static const struct { int type; const void *value; } log_##name[] = {
#define LOG_ADD(kind, name, address) {kind, address},
#define LOG_GROUP_STOP(name) }; const void *const log_group_##name = log_##name;
