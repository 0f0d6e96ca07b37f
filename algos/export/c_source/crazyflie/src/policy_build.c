/* The exported policy, two folders up, as one file that this folder's Kbuild can name. */
#include "../../policy.c"
#include "../../policy_test.c"
