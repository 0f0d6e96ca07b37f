/* Whether the policy may command this drone: plain C, tested on the host. */
#ifndef GUARD_H
#define GUARD_H

#include <stdbool.h>
#include <stdint.h>

struct guard_limits {
    float largest_tilt_rad;    /* of body z from world z */
    float lowest_m;            /* height above ground */
    float highest_m;           /* height above ground */
    float corridor_m;          /* largest distance from the course, |x| */
    float oldest_state_s;      /* age of the own state */
    float oldest_neighbour_s;  /* age of the message of any neighbour */
};

/* What is known of the drone now. */
struct guard_view {
    bool armed;
    bool self_test_passed;
    float position_m[3];    /* world */
    float attitude_wxyz[4]; /* body to world */
    float state_age_s;
    float neighbour_age_s;  /* of the neighbour that was heard longest ago; infinite before the first message of all */
    uint32_t problems;      /* of the last policy_compute */
};

enum guard_reason {
    GUARD_CLEAR = 0,
    GUARD_SELF_TEST_FAILED = 1,
    GUARD_NOT_ARMED = 2,
    GUARD_STATE_INVALID = 3,
    GUARD_STATE_OLD = 4,
    GUARD_TILTED = 5,
    GUARD_LOW = 6,
    GUARD_HIGH = 7,
    GUARD_LEFT_CORRIDOR = 8,
    GUARD_NEIGHBOUR_LOST = 9
};

/* The guard remembers: once it has taken the policy's command away, it keeps it until guard_reset. */
struct guard {
    enum guard_reason reason;
};

void guard_reset(struct guard *guard);

/* Whether the policy may command; `guard->reason` says why not. What is no number counts as out of bounds. */
bool guard_allows(struct guard *guard, const struct guard_limits *limits, const struct guard_view *view);

#endif
