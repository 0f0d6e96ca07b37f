#pragma once
#include "stabilizer_types.h"
#define COMMANDER_PRIORITY_EXTRX 3
void commanderSetSetpoint(setpoint_t *setpoint, int priority);
void commanderRelaxPriority(void);
