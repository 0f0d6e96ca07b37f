/* Declarations of what the application uses of the firmware, for compiling it without; written from its documentation. */
#pragma once
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
typedef uint32_t TickType_t;
#define M2T(x) ((TickType_t)(x))
#define T2M(x) ((uint32_t)(x))
