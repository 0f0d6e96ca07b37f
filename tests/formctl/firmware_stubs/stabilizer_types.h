#pragma once
#include <stdbool.h>
#include <stdint.h>
typedef enum { modeDisable = 0, modeAbs, modeVelocity } stab_mode_t;
typedef struct { float roll, pitch, yaw; } attitude_t;
typedef struct { float x, y, z; } vector_t;
typedef struct {
    attitude_t attitude, attitudeRate;
    float thrust;
    vector_t position, velocity;
    struct { stab_mode_t x, y, z, roll, pitch, yaw, quat; } mode;
} setpoint_t;
