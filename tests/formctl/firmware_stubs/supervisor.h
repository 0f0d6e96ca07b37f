#pragma once
#include <stdbool.h>
bool supervisorIsArmed(void);
bool supervisorCanFly(void);
bool supervisorIsTumbled(void);
