/* The self-test of policy.h. Leave this file out where its flash is wanted: policy.c does not need it. */
#include <math.h>
#include <stddef.h>

#include "policy.h"
#include "policy_golden.h"

uint32_t policy_self_test(float *largest_difference)
{
    uint32_t problems = 0;
    float largest = 0.0f;
    struct policy_setpoint setpoint;

    if (policy_weights_crc32() != POLICY_WEIGHTS_CRC32) {
        problems |= POLICY_WEIGHTS_CHANGED;
    }
    if (sizeof(struct policy_inputs) != POLICY_INPUTS_BYTES) {
        problems |= POLICY_LAYOUT_WRONG;
    }
    for (size_t i = 0; i < POLICY_GOLDEN_COUNT; i++) {
        (void)policy_compute(&policy_golden[i].inputs, &setpoint);
        for (size_t k = 0; k < 4; k++) {
            const float difference = fabsf(setpoint.command[k] - policy_golden[i].command[k]);
            largest = difference > largest ? difference : largest;
        }
    }
    if (!(largest <= POLICY_TOLERANCE)) {
        problems |= POLICY_GOLDEN_DIFFERS;
    }
    if (largest_difference != NULL) {
        *largest_difference = largest;
    }
    return problems;
}
