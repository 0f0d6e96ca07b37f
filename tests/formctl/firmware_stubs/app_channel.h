#pragma once
#include <stddef.h>
size_t appchannelReceiveDataPacket(void *buffer, size_t max_length, int timeout_ms);
