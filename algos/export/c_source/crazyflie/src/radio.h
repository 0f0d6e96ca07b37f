/* What drones tell each other and what the ground tells them: packets and the tables filled from them. Plain C. */
#ifndef RADIO_H
#define RADIO_H

#include <stdbool.h>
#include <stdint.h>

#include "../../policy.h"

#define RADIO_STATE_BYTES 26  /* slot, sequence, position and velocity: a peer-to-peer packet carries 60 */
#define RADIO_GROUND_BYTES 27 /* the longest packet from the ground: the app channel carries 31 */

/* Everything heard, with the times in s at which it was. */
struct radio_tables {
    bool heard[POLICY_DRONES];
    float neighbour_time_s[POLICY_DRONES];
    struct policy_neighbour neighbour[POLICY_DRONES];
    uint32_t columns;
    struct policy_column column[POLICY_MAX_COLUMNS];
    bool flying[POLICY_MAX_BALLS];
    float ball_time_s[POLICY_MAX_BALLS];
    struct policy_ball ball[POLICY_MAX_BALLS];
};

void radio_clear(struct radio_tables *tables);

/* Own state as RADIO_STATE_BYTES for the other drones. */
void radio_pack_state(uint8_t *bytes, uint8_t slot, uint8_t sequence, const float position_m[3],
                      const float velocity_m_s[3]);

/* Takes a packet of another drone. Returns false for one that is none. */
bool radio_hear_drone(struct radio_tables *tables, const uint8_t *bytes, uint32_t length, float now_s);

/* Takes a packet from the ground: 'C' index count x y, a column of `count`; or 'B' index flying position velocity, a
 * ball as it is seen now. Returns false for one that is neither. */
bool radio_hear_ground(struct radio_tables *tables, const uint8_t *bytes, uint32_t length, float now_s);

/* Fills neighbours, balls and columns of `inputs`, extrapolated to `now_s`: neighbours at constant velocity, balls in
 * free fall. Balls not seen for longer than `oldest_ball_s` are left out. */
void radio_fill(struct policy_inputs *inputs, const struct radio_tables *tables, uint32_t own_slot, float now_s,
                float oldest_ball_s);

/* Age in s of the message of the neighbour that was heard longest ago; infinite until all were heard. */
float radio_oldest_neighbour(const struct radio_tables *tables, uint32_t own_slot, float now_s);

#endif
