/* Many drones in one call, for programs that load the policy as a shared library. Not for the drone. */
#include "policy_batch.h"

void policy_compute_batch(const struct policy_inputs *inputs, struct policy_setpoint *setpoints, uint32_t *problems,
                          uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        problems[i] = policy_compute(&inputs[i], &setpoints[i]);
    }
}

uint32_t policy_inputs_bytes(void)
{
    return (uint32_t)sizeof(struct policy_inputs);
}
