#pragma once
#include <stdbool.h>
#include <stdint.h>
#define P2P_MAX_DATA_SIZE 60
typedef struct {
    uint8_t size, rssi, port, data[P2P_MAX_DATA_SIZE];
} P2PPacket;
bool radiolinkSendP2PPacketBroadcast(P2PPacket *packet);
void p2pRegisterCB(void (*callback)(P2PPacket *packet));
