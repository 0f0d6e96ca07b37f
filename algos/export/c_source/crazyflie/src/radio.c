#include "radio.h"

#include <math.h>
#include <string.h>

static const float slots_m[POLICY_DRONES][3] = POLICY_SLOTS_M;

void radio_clear(struct radio_tables *tables)
{
    memset(tables, 0, sizeof *tables);
}

void radio_pack_state(uint8_t *bytes, uint8_t slot, uint8_t sequence, const float position_m[3],
                      const float velocity_m_s[3])
{
    bytes[0] = slot;
    bytes[1] = sequence;
    memcpy(bytes + 2, position_m, 3 * sizeof(float));
    memcpy(bytes + 14, velocity_m_s, 3 * sizeof(float));
}

bool radio_hear_drone(struct radio_tables *tables, const uint8_t *bytes, uint32_t length, float now_s)
{
    if (length != RADIO_STATE_BYTES || bytes[0] >= POLICY_DRONES) {
        return false;
    }
    const uint8_t slot = bytes[0];
    struct policy_neighbour *other = &tables->neighbour[slot];
    memcpy(other->position_m, bytes + 2, sizeof other->position_m);
    memcpy(other->velocity_m_s, bytes + 14, sizeof other->velocity_m_s);
    memcpy(other->slot_m, slots_m[slot], sizeof other->slot_m);
    tables->neighbour_time_s[slot] = now_s;
    tables->heard[slot] = true;
    return true;
}

bool radio_hear_ground(struct radio_tables *tables, const uint8_t *bytes, uint32_t length, float now_s)
{
    if (length == 11 && bytes[0] == 'C' && bytes[1] < POLICY_MAX_COLUMNS && bytes[2] <= POLICY_MAX_COLUMNS) {
        memcpy(tables->column[bytes[1]].axis_m, bytes + 3, 2 * sizeof(float));
        tables->columns = bytes[2];
        return true;
    }
    if (length == RADIO_GROUND_BYTES && bytes[0] == 'B' && bytes[1] < POLICY_MAX_BALLS) {
        struct policy_ball *ball = &tables->ball[bytes[1]];
        tables->flying[bytes[1]] = bytes[2] != 0;
        tables->ball_time_s[bytes[1]] = now_s;
        memcpy(ball->position_m, bytes + 3, sizeof ball->position_m);
        memcpy(ball->velocity_m_s, bytes + 15, sizeof ball->velocity_m_s);
        return true;
    }
    return false;
}

static void fill_neighbours(struct policy_inputs *inputs, const struct radio_tables *tables, uint32_t own_slot,
                            float now_s)
{
    inputs->neighbours = 0;
    for (uint32_t slot = 0; slot < POLICY_DRONES && inputs->neighbours < POLICY_MAX_NEIGHBOURS; slot++) {
        if (slot == own_slot || !tables->heard[slot]) {
            continue;
        }
        struct policy_neighbour *other = &inputs->neighbour[inputs->neighbours++];
        *other = tables->neighbour[slot];
        for (int i = 0; i < 3; i++) {
            other->position_m[i] += other->velocity_m_s[i] * (now_s - tables->neighbour_time_s[slot]);
        }
    }
}

static void fill_balls(struct policy_inputs *inputs, const struct radio_tables *tables, float now_s, float oldest_s)
{
    inputs->balls = 0;
    for (uint32_t i = 0; i < POLICY_MAX_BALLS; i++) {
        const float age = now_s - tables->ball_time_s[i];
        if (!tables->flying[i] || age > oldest_s) {
            continue;
        }
        struct policy_ball *ball = &inputs->ball[inputs->balls++];
        *ball = tables->ball[i];
        for (int k = 0; k < 3; k++) {
            ball->position_m[k] += ball->velocity_m_s[k] * age;
        }
        ball->position_m[2] -= POLICY_GRAVITY_M_S2 / 2.0f * age * age;
        ball->velocity_m_s[2] -= POLICY_GRAVITY_M_S2 * age;
    }
}

void radio_fill(struct policy_inputs *inputs, const struct radio_tables *tables, uint32_t own_slot, float now_s,
                float oldest_ball_s)
{
    fill_neighbours(inputs, tables, own_slot, now_s);
    fill_balls(inputs, tables, now_s, oldest_ball_s);
    inputs->columns = tables->columns;
    memcpy(inputs->column, tables->column, sizeof inputs->column);
}

float radio_oldest_neighbour(const struct radio_tables *tables, uint32_t own_slot, float now_s)
{
    float oldest = 0.0f;
    for (uint32_t slot = 0; slot < POLICY_DRONES; slot++) {
        if (slot != own_slot) {
            const float age = tables->heard[slot] ? now_s - tables->neighbour_time_s[slot] : INFINITY;
            oldest = age > oldest ? age : oldest;
        }
    }
    return oldest;
}
