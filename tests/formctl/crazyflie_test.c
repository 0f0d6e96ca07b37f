/* The guard and the packets of the exported Crazyflie application, on the host. Prints the number of checks. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "guard.h"
#include "radio.h"

static int checks = 0;
static int failures = 0;

#define CHECK(what)                                        \
    do {                                                   \
        checks++;                                          \
        if (!(what)) {                                     \
            failures++;                                    \
            printf("line %d: %s\n", __LINE__, #what);      \
        }                                                  \
    } while (0)

static const struct guard_limits limits = {1.0f, 0.3f, 3.0f, 2.5f, 0.1f, 0.3f};

static struct guard_view safe(void)
{
    struct guard_view view = {true, true, {0.0f, 5.0f, 1.5f}, {1.0f, 0.0f, 0.0f, 0.0f}, 0.01f, 0.05f, 0U};
    return view;
}

static enum guard_reason judged(const struct guard_view *view)
{
    struct guard guard;
    guard_reset(&guard);
    (void)guard_allows(&guard, &limits, view);
    return guard.reason;
}

static void guard_names_each_danger(void)
{
    struct guard_view view = safe();
    CHECK(judged(&view) == GUARD_CLEAR);
    view = safe(), view.self_test_passed = false;
    CHECK(judged(&view) == GUARD_SELF_TEST_FAILED);
    view = safe(), view.armed = false;
    CHECK(judged(&view) == GUARD_NOT_ARMED);
    view = safe(), view.problems = POLICY_STATE_INVALID;
    CHECK(judged(&view) == GUARD_STATE_INVALID);
    view = safe(), view.position_m[1] = NAN;
    CHECK(judged(&view) == GUARD_STATE_INVALID);
    view = safe(), view.attitude_wxyz[3] = INFINITY;
    CHECK(judged(&view) == GUARD_STATE_INVALID);
    view = safe(), view.state_age_s = 0.11f;
    CHECK(judged(&view) == GUARD_STATE_OLD);
    view = safe(), view.state_age_s = NAN;
    CHECK(judged(&view) == GUARD_STATE_OLD);
    view = safe(), view.attitude_wxyz[0] = cosf(0.51f), view.attitude_wxyz[1] = sinf(0.51f);
    CHECK(judged(&view) == GUARD_TILTED);
    view = safe(), view.attitude_wxyz[0] = cosf(0.49f), view.attitude_wxyz[2] = sinf(0.49f);
    CHECK(judged(&view) == GUARD_CLEAR);
    view = safe(), view.attitude_wxyz[0] = cosf(1.5f), view.attitude_wxyz[3] = sinf(1.5f);
    CHECK(judged(&view) == GUARD_CLEAR); /* yaw is no tilt */
    view = safe(), view.position_m[2] = 0.29f;
    CHECK(judged(&view) == GUARD_LOW);
    view = safe(), view.position_m[2] = 3.01f;
    CHECK(judged(&view) == GUARD_HIGH);
    view = safe(), view.position_m[0] = -2.51f;
    CHECK(judged(&view) == GUARD_LEFT_CORRIDOR);
    view = safe(), view.neighbour_age_s = 0.31f;
    CHECK(judged(&view) == GUARD_NEIGHBOUR_LOST);
    view = safe(), view.neighbour_age_s = INFINITY;
    CHECK(judged(&view) == GUARD_NEIGHBOUR_LOST);
}

static void guard_remembers(void)
{
    struct guard guard;
    struct guard_view view = safe();
    guard_reset(&guard);
    CHECK(guard_allows(&guard, &limits, &view));
    view.position_m[2] = 4.0f;
    CHECK(!guard_allows(&guard, &limits, &view) && guard.reason == GUARD_HIGH);
    view = safe();
    CHECK(!guard_allows(&guard, &limits, &view) && guard.reason == GUARD_HIGH);
    guard_reset(&guard);
    CHECK(guard_allows(&guard, &limits, &view));
}

static void drones_hear_each_other(void)
{
    static struct radio_tables tables;
    static struct policy_inputs inputs;
    uint8_t bytes[RADIO_STATE_BYTES];
    const float position_m[3] = {1.0f, 2.0f, 3.0f};
    const float velocity_m_s[3] = {0.5f, -1.0f, 0.0f};
    const float slots_m[POLICY_DRONES][3] = POLICY_SLOTS_M;

    radio_clear(&tables);
    CHECK(isinf(radio_oldest_neighbour(&tables, 0, 1.0f)));
    radio_pack_state(bytes, 1, 7, position_m, velocity_m_s);
    CHECK(RADIO_STATE_BYTES <= 60 && bytes[0] == 1 && bytes[1] == 7);
    CHECK(radio_hear_drone(&tables, bytes, sizeof bytes, 1.0f));
    CHECK(!radio_hear_drone(&tables, bytes, sizeof bytes - 1, 1.0f));
    CHECK(isinf(radio_oldest_neighbour(&tables, 0, 1.2f))); /* the third was not heard */
    radio_fill(&inputs, &tables, 0, 1.2f, 0.2f);
    CHECK(inputs.neighbours == 1);
    CHECK(fabsf(inputs.neighbour[0].position_m[0] - 1.1f) < 1e-6f); /* 0.2 s later */
    CHECK(fabsf(inputs.neighbour[0].position_m[1] - 1.8f) < 1e-6f);
    CHECK(memcmp(inputs.neighbour[0].slot_m, slots_m[1], sizeof slots_m[1]) == 0);
    radio_pack_state(bytes, 2, 0, position_m, velocity_m_s);
    CHECK(radio_hear_drone(&tables, bytes, sizeof bytes, 1.15f));
    CHECK(fabsf(radio_oldest_neighbour(&tables, 0, 1.2f) - 0.2f) < 1e-6f);
    radio_fill(&inputs, &tables, 1, 1.2f, 0.2f);
    CHECK(inputs.neighbours == 1); /* not itself */
    bytes[0] = POLICY_DRONES;
    CHECK(!radio_hear_drone(&tables, bytes, sizeof bytes, 1.0f));
}

static void the_ground_tells_obstacles(void)
{
    static struct radio_tables tables;
    static struct policy_inputs inputs;
    uint8_t bytes[RADIO_GROUND_BYTES] = {'C', 1, 2};
    const float axis_m[2] = {0.5f, 12.0f};
    const float ball[6] = {0.0f, 3.0f, 2.0f, 1.0f, -4.0f, 3.0f};

    radio_clear(&tables);
    memcpy(bytes + 3, axis_m, sizeof axis_m);
    CHECK(radio_hear_ground(&tables, bytes, 11, 0.0f));
    CHECK(tables.columns == 2 && tables.column[1].axis_m[1] == 12.0f);
    bytes[1] = POLICY_MAX_COLUMNS;
    CHECK(!radio_hear_ground(&tables, bytes, 11, 0.0f));
    bytes[0] = 'B', bytes[1] = 3, bytes[2] = 1;
    memcpy(bytes + 3, ball, sizeof ball);
    CHECK(radio_hear_ground(&tables, bytes, sizeof bytes, 5.0f));
    radio_fill(&inputs, &tables, 0, 5.1f, 0.2f);
    CHECK(inputs.balls == 1 && inputs.columns == 2);
    CHECK(fabsf(inputs.ball[0].position_m[1] - 2.6f) < 1e-5f);
    CHECK(fabsf(inputs.ball[0].position_m[2] - (2.0f + 0.3f - 0.5f * 9.81f * 0.01f)) < 1e-5f);
    CHECK(fabsf(inputs.ball[0].velocity_m_s[2] - (3.0f - 0.981f)) < 1e-5f);
    radio_fill(&inputs, &tables, 0, 5.3f, 0.2f);
    CHECK(inputs.balls == 0); /* not seen for too long */
    bytes[0] = 'X';
    CHECK(!radio_hear_ground(&tables, bytes, sizeof bytes, 5.0f));
}

int main(void)
{
    guard_names_each_danger();
    guard_remembers();
    drones_hear_each_other();
    the_ground_tells_obstacles();
    printf("%d checks, %d failures\n", checks, failures);
    return failures != 0;
}
