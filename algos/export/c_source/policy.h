/*
 * A trained formation policy as one pure function of one drone's measurements.
 *
 * Everything between sensed state and set-point is inside: the observation with its scaling, the attention encoder,
 * tanh and the limits of the command. C99, single precision, no heap, no recursion, no state between calls.
 *
 * Frames. World: x right of the course, y along it, z up, origin on the ground below the formation's start. Body:
 * x forward, y left, z up. Quaternions are w, x, y, z and rotate body vectors into the world. Rates follow the
 * right-hand rule. Units stand in the names.
 *
 * What this policy is, and the constants of its task, stand in policy_config.h, which is generated.
 */
#ifndef POLICY_H
#define POLICY_H

#include <stdbool.h>
#include <stdint.h>

#include "policy_config.h"

/* Another drone of the formation, as it was last heard, extrapolated to now. */
struct policy_neighbour {
    float position_m[3];   /* world */
    float velocity_m_s[3]; /* world */
    float slot_m[3];       /* its place in the formation, from the formation's reference point */
};

/* A ball in the air. Balls below POLICY_BALL_LANDED_M or beyond POLICY_SENSING_RANGE_M are not looked at. */
struct policy_ball {
    float position_m[3];   /* world */
    float velocity_m_s[3]; /* world */
};

/* The axis of a vertical column. */
struct policy_column {
    float axis_m[2]; /* world x, y */
};

struct policy_inputs {
    float time_s;              /* since the start of the flight */
    float position_m[3];       /* world */
    float attitude_wxyz[4];    /* body to world, unit quaternion with w >= 0 */
    float velocity_m_s[3];     /* world */
    float body_rates_rad_s[3]; /* about body x, y, z */
    float slot_m[3];           /* own place in the formation: one of POLICY_SLOTS_M */
    float previous_command[4]; /* the `command` of the call before; at first POLICY_HOVER_COMMAND */
    uint32_t neighbours;       /* entries of `neighbour` that are filled */
    uint32_t balls;            /* entries of `ball` that are filled */
    uint32_t columns;          /* entries of `column` that are filled */
    struct policy_neighbour neighbour[POLICY_MAX_NEIGHBOURS];
    struct policy_ball ball[POLICY_MAX_BALLS];
    struct policy_column column[POLICY_MAX_COLUMNS];
};

struct policy_setpoint {
    float body_rates_rad_s[3]; /* about body x, y, z, within +-POLICY_RATE_CLIP_RAD_S */
    float thrust_share;        /* collective thrust along body z as a share of full scale, within its limits */
    float command[4];          /* roll, pitch, yaw rate and thrust in [-1, 1], before the limits: next previous_command */
};

/* What was wrong with the inputs: 0, or a sum of these. The set-point is within its limits whatever they are. */
enum {
    POLICY_STATE_INVALID = 1,     /* time, own state or previous command: the set-point hovers, nothing was computed */
    POLICY_NEIGHBOUR_IGNORED = 2, /* an entry was not finite or out of range, and counts as absent */
    POLICY_BALL_IGNORED = 4,
    POLICY_COLUMN_IGNORED = 8,
    POLICY_TOO_MANY = 16 /* more entries than room: those beyond it were not looked at */
};

/* The set-point for one drone. Returns 0, or what was wrong with the inputs. */
uint32_t policy_compute(const struct policy_inputs *inputs, struct policy_setpoint *setpoint);

/* CRC-32 (IEEE 802.3) of the weights as they lie in memory; POLICY_WEIGHTS_CRC32 unless they were changed. */
uint32_t policy_weights_crc32(void);

/* What policy_self_test found: 0, or a sum of these. */
enum { POLICY_WEIGHTS_CHANGED = 1, POLICY_LAYOUT_WRONG = 2, POLICY_GOLDEN_DIFFERS = 4 };

/* Checks the weights' hash and the size of policy_inputs, and computes the golden inputs of policy_golden.h, whose
 * commands must come out within POLICY_TOLERANCE. `largest_difference` may be NULL. */
uint32_t policy_self_test(float *largest_difference);

#endif
