/* What policy.c needs of a C library's mathematics, as instructions of the processor. */
#ifndef BOARD_MATH_H
#define BOARD_MATH_H
#define sqrtf __builtin_sqrtf
#define fabsf __builtin_fabsf
#endif
