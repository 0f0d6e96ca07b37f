#include "guard.h"

#include <math.h>

#include "../../policy.h"

static bool finite_state(const struct guard_view *view)
{
    float sum = 0.0f;
    for (int i = 0; i < 3; i++) {
        sum += fabsf(view->position_m[i]);
    }
    for (int i = 0; i < 4; i++) {
        sum += fabsf(view->attitude_wxyz[i]);
    }
    return sum < 1e6f; /* false for what is no number */
}

static enum guard_reason judge(const struct guard_limits *limits, const struct guard_view *view)
{
    const float *q = view->attitude_wxyz;
    if (!view->self_test_passed) {
        return GUARD_SELF_TEST_FAILED;
    }
    if (!view->armed) {
        return GUARD_NOT_ARMED;
    }
    if ((view->problems & POLICY_STATE_INVALID) != 0U || !finite_state(view)) {
        return GUARD_STATE_INVALID;
    }
    if (!(view->state_age_s <= limits->oldest_state_s)) {
        return GUARD_STATE_OLD;
    }
    if (!(1.0f - 2.0f * (q[1] * q[1] + q[2] * q[2]) >= cosf(limits->largest_tilt_rad))) {
        return GUARD_TILTED;
    }
    if (!(view->position_m[2] >= limits->lowest_m)) {
        return GUARD_LOW;
    }
    if (!(view->position_m[2] <= limits->highest_m)) {
        return GUARD_HIGH;
    }
    if (!(fabsf(view->position_m[0]) <= limits->corridor_m)) {
        return GUARD_LEFT_CORRIDOR;
    }
    if (!(view->neighbour_age_s <= limits->oldest_neighbour_s)) {
        return GUARD_NEIGHBOUR_LOST;
    }
    return GUARD_CLEAR;
}

void guard_reset(struct guard *guard)
{
    guard->reason = GUARD_CLEAR;
}

bool guard_allows(struct guard *guard, const struct guard_limits *limits, const struct guard_view *view)
{
    if (guard->reason == GUARD_CLEAR) {
        guard->reason = judge(limits, view);
    }
    return guard->reason == GUARD_CLEAR;
}
