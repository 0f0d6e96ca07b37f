/* The policy on a bare Cortex-M4, for the emulator: set up, compute what lies in RAM, stop at a breakpoint. */
#include "policy_batch.h"

#define MAX_DRONES 256

/* Read and written by the emulator. */
struct policy_inputs board_inputs[MAX_DRONES];
struct policy_setpoint board_setpoints[MAX_DRONES];
uint32_t board_problems[MAX_DRONES];
uint32_t board_count;
uint32_t board_self_test;
float board_largest_difference;

/* Entered by the emulator, with the floating-point unit on and the stack pointer set. */
void board_compute(void)
{
    policy_compute_batch(board_inputs, board_setpoints, board_problems, board_count);
    __asm__ volatile("bkpt #0");
}

void board_test(void)
{
    board_self_test = policy_self_test(&board_largest_difference);
    __asm__ volatile("bkpt #0");
}
