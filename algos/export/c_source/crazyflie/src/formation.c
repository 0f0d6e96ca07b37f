/*
 * Formation flight on a Crazyflie 2.x: the exported policy in the application task, below the stabiliser.
 *
 * NOBODY HAS FLOWN THIS. It has been compiled against declarations of the firmware's interfaces, and the guard, the
 * packets and the policy were tested on other machines. Read crazyflie/README.md before a propeller turns.
 *
 * 50 times a second: read the own state, tell the neighbours, ask the guard, compute, and hand a rate-mode set-point
 * (body rates and thrust) to the commander; the stock rate controller stays in charge of the motors. Once the guard
 * says no, the stock controller holds height and zero velocity until formation.start is set to 0.
 */
#include <math.h>
#include <string.h>

#include "FreeRTOS.h"
#include "app.h"
#include "app_channel.h"
#include "commander.h"
#include "log.h"
#include "param.h"
#include "radiolink.h"
#include "supervisor.h"
#include "task.h"

#include "../../policy.h"
#include "guard.h"
#include "radio.h"

#define PERIOD_MS ((uint32_t)(1000.0f * POLICY_PERIOD_S + 0.5f))
#define DEGREES 57.2957795f
#define OLDEST_BALL_S 0.2f
#define RADIO_PORT 0x07

static const float slots_m[POLICY_DRONES][3] = POLICY_SLOTS_M;
static const float hover_command[4] = POLICY_HOVER_COMMAND;

/* Parameters. */
static uint8_t slot = 0;  /* which of POLICY_SLOTS_M is this drone's */
static uint8_t start = 0; /* 1: the policy flies; 0: it does not, and the guard forgets */
static struct guard_limits limits = {
    .largest_tilt_rad = 1.05f,
    .lowest_m = 0.3f,
    .highest_m = 3.0f,
    .corridor_m = 2.5f,
    .oldest_state_s = 0.1f,
    .oldest_neighbour_s = 0.3f,
};

/* Logged. */
static uint8_t reason = 0;      /* of the guard, see guard.h */
static uint16_t self_test = 0;  /* see policy.h; 0 passed */
static float compute_ms = 0.0f; /* the last inference, in ticks of 1 ms */

static struct radio_tables tables;
static struct policy_inputs inputs;
static struct policy_setpoint command;
static struct guard guard;

struct own_state {
    logVarId_t position[3], velocity[3], quaternion[4], gyro[3];
    float last[3];
    float changed_s;
};

static void find_variables(struct own_state *own)
{
    static const char *const axes[3] = {"x", "y", "z"};
    static const char *const speeds[3] = {"vx", "vy", "vz"};
    static const char *const parts[4] = {"qw", "qx", "qy", "qz"};
    for (int i = 0; i < 3; i++) {
        own->position[i] = logGetVarId("stateEstimate", axes[i]);
        own->velocity[i] = logGetVarId("stateEstimate", speeds[i]);
        own->gyro[i] = logGetVarId("gyro", axes[i]);
    }
    for (int i = 0; i < 4; i++) {
        own->quaternion[i] = logGetVarId("stateEstimate", parts[i]);
    }
}

/* The estimator's state into `inputs`. Its age is the time since it last changed: the estimator gives no other. */
static void read_state(struct own_state *own, float now_s)
{
    for (int i = 0; i < 3; i++) {
        inputs.position_m[i] = logGetFloat(own->position[i]);
        inputs.velocity_m_s[i] = logGetFloat(own->velocity[i]);
        inputs.body_rates_rad_s[i] = logGetFloat(own->gyro[i]) / DEGREES;
    }
    const float sign = logGetFloat(own->quaternion[0]) < 0.0f ? -1.0f : 1.0f; /* the policy knows w >= 0 */
    for (int i = 0; i < 4; i++) {
        inputs.attitude_wxyz[i] = sign * logGetFloat(own->quaternion[i]);
    }
    if (memcmp(own->last, inputs.position_m, sizeof own->last) != 0) {
        memcpy(own->last, inputs.position_m, sizeof own->last);
        own->changed_s = now_s;
    }
}

static void tell_neighbours(void)
{
    static P2PPacket packet;
    static uint8_t sequence;
    packet.port = RADIO_PORT;
    packet.size = RADIO_STATE_BYTES;
    radio_pack_state(packet.data, slot, sequence++, inputs.position_m, inputs.velocity_m_s);
    radiolinkSendP2PPacketBroadcast(&packet);
}

static void hear_drone(P2PPacket *packet)
{
    if (packet->port == RADIO_PORT) {
        (void)radio_hear_drone(&tables, packet->data, packet->size, (float)T2M(xTaskGetTickCount()) / 1000.0f);
    }
}

static void hear_ground(float now_s)
{
    uint8_t bytes[RADIO_GROUND_BYTES];
    size_t length;
    while ((length = appchannelReceiveDataPacket(bytes, sizeof bytes, 0)) > 0) {
        (void)radio_hear_ground(&tables, bytes, (uint32_t)length, now_s);
    }
}

/* Body rates and thrust. The firmware compares attitudeRate.pitch with minus the gyroscope's y. */
static void fly(void)
{
    setpoint_t setpoint;
    memset(&setpoint, 0, sizeof setpoint);
    setpoint.mode.roll = modeVelocity;
    setpoint.mode.pitch = modeVelocity;
    setpoint.mode.yaw = modeVelocity;
    setpoint.attitudeRate.roll = DEGREES * command.body_rates_rad_s[0];
    setpoint.attitudeRate.pitch = -DEGREES * command.body_rates_rad_s[1];
    setpoint.attitudeRate.yaw = DEGREES * command.body_rates_rad_s[2];
    setpoint.thrust = 65535.0f * fminf(1.0f, command.thrust_share + POLICY_THRUST_BIAS_SHARE);
    commanderSetSetpoint(&setpoint, COMMANDER_PRIORITY_EXTRX);
}

/* The stock controller holds the height and stands still. */
static void hover(float height_m)
{
    setpoint_t setpoint;
    memset(&setpoint, 0, sizeof setpoint);
    setpoint.mode.x = modeVelocity;
    setpoint.mode.y = modeVelocity;
    setpoint.mode.z = modeAbs;
    setpoint.mode.yaw = modeVelocity;
    setpoint.position.z = height_m;
    commanderSetSetpoint(&setpoint, COMMANDER_PRIORITY_EXTRX);
}

static void look(struct guard_view *view, const struct own_state *own, float now_s)
{
    view->armed = supervisorIsArmed() && supervisorCanFly() && !supervisorIsTumbled();
    view->self_test_passed = self_test == 0;
    memcpy(view->position_m, inputs.position_m, sizeof view->position_m);
    memcpy(view->attitude_wxyz, inputs.attitude_wxyz, sizeof view->attitude_wxyz);
    view->state_age_s = now_s - own->changed_s;
    view->neighbour_age_s = radio_oldest_neighbour(&tables, slot, now_s);
}

static void compute(struct guard_view *view, float now_s, float since_s)
{
    inputs.time_s = since_s;
    memcpy(inputs.slot_m, slots_m[slot], sizeof inputs.slot_m);
    radio_fill(&inputs, &tables, slot, now_s, OLDEST_BALL_S);
    const TickType_t before = xTaskGetTickCount();
    view->problems = policy_compute(&inputs, &command);
    compute_ms = (float)T2M(xTaskGetTickCount() - before);
    memcpy(inputs.previous_command, command.command, sizeof inputs.previous_command);
}

void appMain(void)
{
    static struct own_state own;
    struct guard_view view = {0};
    float started_s = 0.0f;
    float height_m = POLICY_HEIGHT_M;
    bool flying = false;    /* start was set */
    bool commanded = false; /* the policy has flown since: until then the guard takes nothing over */
    TickType_t woken = xTaskGetTickCount();

    find_variables(&own);
    radio_clear(&tables);
    p2pRegisterCB(hear_drone);
    self_test = (uint16_t)policy_self_test(NULL);
    while (1) {
        vTaskDelayUntil(&woken, M2T(PERIOD_MS));
        const float now_s = (float)T2M(woken) / 1000.0f;
        read_state(&own, now_s);
        hear_ground(now_s);
        tell_neighbours();
        if (start == 0 || slot >= POLICY_DRONES) {
            if (commanded) {
                commanderRelaxPriority();
            }
            flying = false;
            commanded = false;
            view.problems = 0;
            guard_reset(&guard);
            reason = (uint8_t)guard.reason;
            continue;
        }
        if (!flying) {
            flying = true;
            started_s = now_s;
            memcpy(inputs.previous_command, hover_command, sizeof hover_command);
        }
        look(&view, &own, now_s);
        compute(&view, now_s, now_s - started_s);
        if (guard_allows(&guard, &limits, &view)) {
            height_m = inputs.position_m[2];
            commanded = true;
            fly();
        } else if (commanded) {
            hover(height_m);
        }
        reason = (uint8_t)guard.reason;
    }
}

PARAM_GROUP_START(formation)
PARAM_ADD(PARAM_UINT8, slot, &slot)
PARAM_ADD(PARAM_UINT8, start, &start)
PARAM_ADD(PARAM_FLOAT, maxTilt, &limits.largest_tilt_rad)
PARAM_ADD(PARAM_FLOAT, minHeight, &limits.lowest_m)
PARAM_ADD(PARAM_FLOAT, maxHeight, &limits.highest_m)
PARAM_ADD(PARAM_FLOAT, corridor, &limits.corridor_m)
PARAM_ADD(PARAM_FLOAT, stateAge, &limits.oldest_state_s)
PARAM_ADD(PARAM_FLOAT, neighbAge, &limits.oldest_neighbour_s)
PARAM_GROUP_STOP(formation)

LOG_GROUP_START(formation)
LOG_ADD(LOG_UINT8, reason, &reason)
LOG_ADD(LOG_UINT16, selfTest, &self_test)
LOG_ADD(LOG_FLOAT, compute, &compute_ms)
LOG_GROUP_STOP(formation)
