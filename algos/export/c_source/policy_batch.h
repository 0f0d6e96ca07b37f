/* Many drones in one call, for programs that load the policy as a shared library. Not for the drone. */
#ifndef POLICY_BATCH_H
#define POLICY_BATCH_H

#include "policy.h"

/* policy_compute for `count` drones; all arrays hold as many entries. */
void policy_compute_batch(const struct policy_inputs *inputs, struct policy_setpoint *setpoints, uint32_t *problems,
                          uint32_t count);

/* sizeof(struct policy_inputs), for callers that lay it out themselves. */
uint32_t policy_inputs_bytes(void);

#endif
