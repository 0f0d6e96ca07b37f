/* See policy.h. Sections: arithmetic, observation, encoder, command. */
#include "policy.h"

#include <math.h>
#include <stddef.h>

#ifdef __FAST_MATH__
#error "policy.c tells inputs that are no numbers by comparing them: compile it without -ffast-math"
#endif

#define WIDTH POLICY_WIDTH
#define HEADS POLICY_HEADS
#define HEAD_WIDTH (WIDTH / HEADS)
#define SELF POLICY_SELF_INPUTS /* numbers in the token of the drone itself */
#define NEIGHBOUR 7
#define BALL 10
#define POINTS 9
#define MAX_TOKENS (1 + POLICY_MAX_NEIGHBOURS + POLICY_MAX_BALLS + 1)

/* Inputs beyond these are taken for broken: large enough for any flight, small enough that nothing overflows. */
#define LARGEST_PLACE 1e4f    /* m */
#define LARGEST_SPEED 1e3f    /* m/s */
#define LARGEST_RATE 1e3f     /* rad/s */
#define LARGEST_TIME 1e5f     /* s */
#define QUATERNION_SLACK 0.1f /* of its squared length */

/* The weights, in the order of policy_weights.h. Matrices lie four outputs at a time: [outputs / 4][inputs][4]. */
struct policy_norm {
    float weight[WIDTH];
    float bias[WIDTH];
};
struct policy_square {
    float weight[WIDTH * WIDTH];
    float bias[WIDTH];
};
struct policy_attention {
    struct policy_square query;
    float key_value_weight[2 * WIDTH * WIDTH];
    float key_value_bias[2 * WIDTH];
    struct policy_square output;
};
struct policy_feed {
    struct policy_square first;
    struct policy_square second;
};
struct policy_weights {
    float embed_self_weight[WIDTH * SELF];
    float embed_self_bias[WIDTH];
    struct policy_square embed_self_second;
    float embed_drones_weight[WIDTH * NEIGHBOUR];
    float embed_drones_bias[WIDTH];
    struct policy_square embed_drones_second;
    float embed_dynamic_weight[WIDTH * BALL];
    float embed_dynamic_bias[WIDTH];
    struct policy_square embed_dynamic_second;
    float embed_static_weight[WIDTH * POINTS];
    float embed_static_bias[WIDTH];
    struct policy_square embed_static_second;
    struct policy_norm norm_mix;
    struct policy_attention mix;
    struct policy_norm norm_tokens;
    struct policy_feed feed_tokens;
    struct policy_norm norm_shared;
    struct policy_attention gather;
    struct policy_norm norm_pair;
    struct policy_feed feed_pair;
    float head_weight[4 * 2 * WIDTH];
    float head_bias[4];
};

#include "policy_weights.h"

/* Tokens of one drone: its own, the neighbours', the balls', the columns'. */
struct tokens {
    float value[MAX_TOKENS][WIDTH];
    float key_value[MAX_TOKENS][2 * WIDTH];
    size_t count;
};

/* ---- Arithmetic ---- */

static float clamped(float value, float low, float high)
{
    return value > low ? (value < high ? value : high) : low; /* low for what is no number */
}

static bool within(const float *values, size_t count, float largest)
{
    bool all = true;
    for (size_t i = 0; i < count; i++) {
        all = all && values[i] >= -largest && values[i] <= largest; /* false for what is no number */
    }
    return all;
}

static float length(const float vector[3])
{
    return sqrtf(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2] + 1e-12f);
}

/* e^x to 2e-7 of it: x = n ln 2 + r, a polynomial in r, and n into the exponent. 0 below -87, saturated above 88. */
static float exponential(float x)
{
    if (x < -87.0f) {
        return 0.0f;
    }
    x = x < 88.0f ? x : 88.0f;
    const int32_t n = (int32_t)(x * 1.44269504f + (x < 0.0f ? -0.5f : 0.5f));
    const float r = (x - (float)n * 0.693359375f) + (float)n * 2.12194440e-4f;
    const float series =
        1.0f + r * (1.0f + r * (0.5f + r * (1.66666667e-1f + r * (4.16666667e-2f + r * (8.33333333e-3f + r * 1.38888889e-3f)))));
    const union {
        uint32_t bits;
        float value;
    } power = {(uint32_t)(n + 127) << 23};
    return series * power.value;
}

/* The error function to 4e-7: a quotient of polynomials, fitted on |x| <= 3.9, beyond which it is 1. */
static float error_function(float x)
{
    const float c = clamped(x, -3.9f, 3.9f);
    const float u = c * c;
    const float above =
        1.12837903f +
        u * (0.191941559f + u * (0.0529669928f + u * (0.00383690037f + u * (2.87457895e-4f + u * 2.05038411e-6f))));
    const float below =
        1.0f + u * (0.503435556f + u * (0.11475843f + u * (0.0151092525f + u * (1.18174051e-3f + u * 3.8230743e-5f))));
    return clamped(c * above / below, -1.0f, 1.0f);
}

static float hyperbolic_tangent(float x)
{
    const float e = exponential(-2.0f * fabsf(x));
    const float size = (1.0f - e) / (1.0f + e);
    return x < 0.0f ? -size : size;
}

/* out = bias + weight in. Weights lie four outputs at a time: [outputs / 4][inputs][4]. */
static void dense(float *restrict out, size_t outputs, const float *restrict in, size_t inputs,
                  const float *restrict weight, const float *restrict bias)
{
    const float *const even = in + (inputs & ~(size_t)1);
    for (size_t first = 0; first < outputs; first += 4) {
        float a = bias[first];
        float b = bias[first + 1];
        float c = bias[first + 2];
        float d = bias[first + 3];
        const float *x = in;
        for (; x != even; x += 2) { /* two inputs a turn: half the counting */
            a += weight[0] * x[0];
            b += weight[1] * x[0];
            c += weight[2] * x[0];
            d += weight[3] * x[0];
            a += weight[4] * x[1];
            b += weight[5] * x[1];
            c += weight[6] * x[1];
            d += weight[7] * x[1];
            weight += 8;
        }
        if (inputs % 2 == 1) {
            a += weight[0] * x[0];
            b += weight[1] * x[0];
            c += weight[2] * x[0];
            d += weight[3] * x[0];
            weight += 4;
        }
        out[first] = a;
        out[first + 1] = b;
        out[first + 2] = c;
        out[first + 3] = d;
    }
}

static void layer_norm(float *restrict out, const float *restrict in, const struct policy_norm *norm)
{
    float mean = 0.0f;
    float variance = 0.0f;
    for (size_t i = 0; i < WIDTH; i++) {
        mean += in[i];
    }
    mean /= (float)WIDTH;
    for (size_t i = 0; i < WIDTH; i++) {
        variance += (in[i] - mean) * (in[i] - mean);
    }
    const float scale = 1.0f / sqrtf(variance / (float)WIDTH + 1e-5f);
    for (size_t i = 0; i < WIDTH; i++) {
        out[i] = (in[i] - mean) * scale * norm->weight[i] + norm->bias[i];
    }
}

/* ---- Encoder (paper, Sec. V-C1) ---- */

/* Adds a token: a two-layer MLP with ELU over the numbers of its group. */
static void embed(struct tokens *tokens, const float *in, size_t inputs, const float *first_weight,
                  const float *first_bias, const struct policy_square *second)
{
    float hidden[WIDTH];
    dense(hidden, WIDTH, in, inputs, first_weight, first_bias);
    for (size_t i = 0; i < WIDTH; i++) {
        hidden[i] = hidden[i] > 0.0f ? hidden[i] : exponential(hidden[i]) - 1.0f;
    }
    dense(tokens->value[tokens->count], WIDTH, hidden, WIDTH, second->weight, second->bias);
    tokens->count++;
}

/* Keys and values of tokens from `first` on, of their normed values. */
static void keys_and_values(struct tokens *tokens, size_t first, const struct policy_norm *norm,
                            const struct policy_attention *attention)
{
    float normed[WIDTH];
    for (size_t t = first; t < tokens->count; t++) {
        layer_norm(normed, tokens->value[t], norm);
        dense(tokens->key_value[t], 2 * WIDTH, normed, WIDTH, attention->key_value_weight, attention->key_value_bias);
    }
}

/* Adds to `out` what a normed token gathers from tokens from `first` on; nothing but the bias where there is none. */
static void attend(float *out, const float *normed, const struct tokens *tokens, size_t first,
                   const struct policy_attention *attention)
{
    float query[WIDTH];
    float gathered[WIDTH] = {0.0f};
    float share[MAX_TOKENS];
    dense(query, WIDTH, normed, WIDTH, attention->query.weight, attention->query.bias);
    for (size_t head = 0; head < WIDTH && first < tokens->count; head += HEAD_WIDTH) {
        float top = -3.0e38f;
        for (size_t t = first; t < tokens->count; t++) {
            float product = 0.0f;
            for (size_t i = head; i < head + HEAD_WIDTH; i++) {
                product += query[i] * tokens->key_value[t][i];
            }
            share[t] = product * POLICY_ATTENTION_SCALE;
            top = share[t] > top ? share[t] : top;
        }
        float total = 0.0f;
        for (size_t t = first; t < tokens->count; t++) {
            share[t] = exponential(share[t] - top); /* of a number at most 0: cannot overflow, one of them is 1 */
            total += share[t];
        }
        for (size_t t = first; t < tokens->count; t++) {
            const float part = share[t] / total;
            for (size_t i = head; i < head + HEAD_WIDTH; i++) {
                gathered[i] += part * tokens->key_value[t][WIDTH + i];
            }
        }
    }
    dense(query, WIDTH, gathered, WIDTH, attention->output.weight, attention->output.bias);
    for (size_t i = 0; i < WIDTH; i++) {
        out[i] += query[i];
    }
}

/* token += feed-forward of its normed value: Linear, GELU, Linear. */
static void feed_forward(float *token, const struct policy_norm *norm, const struct policy_feed *feed)
{
    float normed[WIDTH];
    float hidden[WIDTH];
    layer_norm(normed, token, norm);
    dense(hidden, WIDTH, normed, WIDTH, feed->first.weight, feed->first.bias);
    for (size_t i = 0; i < WIDTH; i++) {
        hidden[i] = 0.5f * hidden[i] * (1.0f + error_function(hidden[i] * 0.707106781f));
    }
    dense(normed, WIDTH, hidden, WIDTH, feed->second.weight, feed->second.bias);
    for (size_t i = 0; i < WIDTH; i++) {
        token[i] += normed[i];
    }
}

/* Self-attention over all tokens, cross-attention of the own token over the others, and the head: u[4]. */
static void encode(struct tokens *tokens, float u[4])
{
    const struct policy_weights *w = &policy_weights;
    float normed[WIDTH];
    float pair[2 * WIDTH];

    keys_and_values(tokens, 0, &w->norm_mix, &w->mix);
    for (size_t t = 0; t < tokens->count; t++) {
        layer_norm(normed, tokens->value[t], &w->norm_mix);
        attend(tokens->value[t], normed, tokens, 0, &w->mix);
        feed_forward(tokens->value[t], &w->norm_tokens, &w->feed_tokens);
    }

    keys_and_values(tokens, 1, &w->norm_shared, &w->gather);
    for (size_t i = 0; i < WIDTH; i++) {
        pair[i] = tokens->value[0][i];
        pair[WIDTH + i] = tokens->value[0][i];
    }
    layer_norm(normed, tokens->value[0], &w->norm_shared);
    attend(pair + WIDTH, normed, tokens, 1, &w->gather);
    feed_forward(pair, &w->norm_pair, &w->feed_pair);
    feed_forward(pair + WIDTH, &w->norm_pair, &w->feed_pair);
    dense(u, 4, pair, 2 * WIDTH, w->head_weight, w->head_bias);
}

/* ---- Observation (paper, Sec. III-B), conditioned: scaled and relative to the course ---- */

static void observe_self(struct tokens *tokens, const struct policy_inputs *in)
{
    static const float wanted_m_s[3] = POLICY_VELOCITY_M_S;
    const float w = in->attitude_wxyz[0];
    const float x = in->attitude_wxyz[1];
    const float y = in->attitude_wxyz[2];
    const float z = in->attitude_wxyz[3];
    float own[SELF] = {
        in->position_m[0],
        0.2f * (in->position_m[1] - (POLICY_START_Y_M + wanted_m_s[1] * in->time_s)),
        in->position_m[2] - POLICY_HEIGHT_M,
        w, x, y, z,
        0.5f * in->velocity_m_s[0], 0.5f * in->velocity_m_s[1], 0.5f * in->velocity_m_s[2],
        0.1f * in->body_rates_rad_s[0], 0.1f * in->body_rates_rad_s[1], 0.1f * in->body_rates_rad_s[2],
        1.0f - 2.0f * (y * y + z * z), 2.0f * (x * y + w * z), 2.0f * (x * z - w * y), /* body x */
        2.0f * (x * z + w * y), 2.0f * (y * z - w * x), 1.0f - 2.0f * (x * x + y * y), /* body z */
        wanted_m_s[0] - in->velocity_m_s[0], wanted_m_s[1] - in->velocity_m_s[1], wanted_m_s[2] - in->velocity_m_s[2],
        in->slot_m[0] / POLICY_FORMATION_SIZE_M, in->slot_m[1] / POLICY_FORMATION_SIZE_M,
        in->slot_m[2] / POLICY_FORMATION_SIZE_M,
    };
#if POLICY_PREVIOUS_COMMAND
    for (size_t i = 0; i < 4; i++) {
        own[25 + i] = in->previous_command[i];
    }
#endif
    embed(tokens, own, SELF, policy_weights.embed_self_weight, policy_weights.embed_self_bias,
          &policy_weights.embed_self_second);
}

/* Where a neighbour is, less where its slot is: the formation's error. */
static void observe_neighbour(struct tokens *tokens, const struct policy_inputs *in, const struct policy_neighbour *other)
{
    float seen[NEIGHBOUR];
    float half[3];
    for (size_t i = 0; i < 3; i++) {
        half[i] = (in->position_m[i] - other->position_m[i]) / 2.0f;
        seen[i] = 2.0f * half[i] - (in->slot_m[i] - other->slot_m[i]);
        seen[4 + i] = in->velocity_m_s[i] - other->velocity_m_s[i];
    }
    seen[3] = length(half);
    embed(tokens, seen, NEIGHBOUR, policy_weights.embed_drones_weight, policy_weights.embed_drones_bias,
          &policy_weights.embed_drones_second);
}

/* When a ball passes closest over ground and its offset then, squashed; its velocities. */
static void observe_ball(struct tokens *tokens, const struct policy_inputs *in, const struct policy_ball *ball)
{
    float offset[3];
    float relative[3];
    float miss[3];
    float seen[BALL];
    for (size_t i = 0; i < 3; i++) {
        offset[i] = ball->position_m[i] - in->position_m[i];
        relative[i] = ball->velocity_m_s[i] - in->velocity_m_s[i];
    }
    if (!(ball->position_m[2] >= POLICY_BALL_LANDED_M && length(offset) <= POLICY_SENSING_RANGE_M)) {
        return;
    }
    const float along = -(offset[0] * relative[0] + offset[1] * relative[1]);
    const float speed = relative[0] * relative[0] + relative[1] * relative[1] + 0.5f;
    seen[0] = clamped(along / speed, 0.0f, POLICY_LOOKAHEAD_S);
    for (size_t i = 0; i < 3; i++) {
        miss[i] = offset[i] + relative[i] * seen[0];
    }
    miss[2] -= POLICY_GRAVITY_M_S2 / 2.0f * (seen[0] * seen[0]);
    const float squash = 0.5f + length(miss);
    for (size_t i = 0; i < 3; i++) {
        seen[1 + i] = miss[i] / squash;
        seen[4 + i] = 0.3f * relative[i];
        seen[7 + i] = 0.3f * ball->velocity_m_s[i];
    }
    embed(tokens, seen, BALL, policy_weights.embed_dynamic_weight, policy_weights.embed_dynamic_bias,
          &policy_weights.embed_dynamic_second);
}

/* Distances of a 3 x 3 grid to the nearest column: the middle one, and differences from it; `nearest` is squared. */
static void observe_columns(struct tokens *tokens, const float nearest[POINTS])
{
    float seen[POINTS];
    const float middle = sqrtf(nearest[4]);
    const float fade = exponential(-0.3f * clamped(middle, 0.0f, 9.0f));
    for (size_t point = 0; point < POINTS; point++) {
        const float difference = (nearest[point] - nearest[4]) / (sqrtf(nearest[point]) + middle);
        seen[point] = fade * (point == 4 ? 1.5f - clamped(middle, 0.0f, 3.0f) : 8.0f * difference);
    }
    embed(tokens, seen, POINTS, policy_weights.embed_static_weight, policy_weights.embed_static_bias,
          &policy_weights.embed_static_second);
}

/* Squared distances of the grid, 0.1 m apart, to one more column; `nearest` holds the least so far. */
static void approach(float nearest[POINTS], const struct policy_inputs *in, const struct policy_column *column)
{
    const float x = in->position_m[0] - column->axis_m[0];
    const float y = in->position_m[1] - column->axis_m[1];
    for (size_t point = 0; point < POINTS; point++) {
        const float dx = x + 0.1f * ((float)(point / 3) - 1.0f);
        const float dy = y + 0.1f * ((float)(point % 3) - 1.0f);
        const float squared = dx * dx + dy * dy + 1e-12f;
        nearest[point] = squared < nearest[point] ? squared : nearest[point];
    }
}

static size_t entries(uint32_t given, size_t room, uint32_t *problems)
{
    if (given > room) {
        *problems |= POLICY_TOO_MANY;
        return room;
    }
    return (size_t)given;
}

static uint32_t observe(struct tokens *tokens, const struct policy_inputs *in)
{
    uint32_t problems = 0;
    const size_t neighbours = entries(in->neighbours, POLICY_MAX_NEIGHBOURS, &problems);
    const size_t balls = entries(in->balls, POLICY_MAX_BALLS, &problems);
    const size_t columns = entries(in->columns, POLICY_MAX_COLUMNS, &problems);

    observe_self(tokens, in);
    for (size_t i = 0; i < neighbours; i++) {
        const struct policy_neighbour *other = &in->neighbour[i];
        if (within(other->position_m, 3, LARGEST_PLACE) && within(other->velocity_m_s, 3, LARGEST_SPEED) &&
            within(other->slot_m, 3, LARGEST_PLACE)) {
            observe_neighbour(tokens, in, other);
        } else {
            problems |= POLICY_NEIGHBOUR_IGNORED;
        }
    }
    for (size_t i = 0; i < balls; i++) {
        const struct policy_ball *ball = &in->ball[i];
        if (within(ball->position_m, 3, LARGEST_PLACE) && within(ball->velocity_m_s, 3, LARGEST_SPEED)) {
            observe_ball(tokens, in, ball);
        } else {
            problems |= POLICY_BALL_IGNORED;
        }
    }
    float nearest[POINTS];
    size_t standing = 0;
    for (size_t point = 0; point < POINTS; point++) {
        nearest[point] = 3.0e38f;
    }
    for (size_t i = 0; i < columns; i++) {
        if (within(in->column[i].axis_m, 2, LARGEST_PLACE)) {
            approach(nearest, in, &in->column[i]);
            standing++;
        } else {
            problems |= POLICY_COLUMN_IGNORED;
        }
    }
    if (standing > 0) {
        observe_columns(tokens, nearest);
    }
    return problems;
}

/* ---- Command ---- */

static bool valid_state(const struct policy_inputs *in)
{
    float square = 0.0f;
    if (!(within(&in->time_s, 1, LARGEST_TIME) && within(in->position_m, 3, LARGEST_PLACE) &&
          within(in->attitude_wxyz, 4, 2.0f) && within(in->velocity_m_s, 3, LARGEST_SPEED) &&
          within(in->body_rates_rad_s, 3, LARGEST_RATE) && within(in->slot_m, 3, LARGEST_PLACE))) {
        return false;
    }
    if (POLICY_PREVIOUS_COMMAND && !within(in->previous_command, 4, 1.0f)) {
        return false;
    }
    for (size_t i = 0; i < 4; i++) {
        square += in->attitude_wxyz[i] * in->attitude_wxyz[i];
    }
    return square > 1.0f - QUATERNION_SLACK && square < 1.0f + QUATERNION_SLACK;
}

/* Body rates and thrust of a command, limited (paper, Sec. III-C). */
static void limit(struct policy_setpoint *setpoint)
{
    for (size_t i = 0; i < 3; i++) {
        setpoint->body_rates_rad_s[i] = clamped(POLICY_RATE_LIMIT_RAD_S * setpoint->command[i],
                                                -POLICY_RATE_CLIP_RAD_S, POLICY_RATE_CLIP_RAD_S);
    }
    setpoint->thrust_share =
        clamped((setpoint->command[3] + 1.0f) / 2.0f, POLICY_THRUST_LEAST_SHARE, POLICY_THRUST_MOST_SHARE);
}

uint32_t policy_compute(const struct policy_inputs *inputs, struct policy_setpoint *setpoint)
{
    static const float hover[4] = POLICY_HOVER_COMMAND;
    struct tokens tokens;
    float u[4];
    uint32_t problems = POLICY_STATE_INVALID;

    for (size_t i = 0; i < 4; i++) {
        setpoint->command[i] = hover[i];
    }
    if (valid_state(inputs)) {
        tokens.count = 0;
        problems = observe(&tokens, inputs);
        encode(&tokens, u);
        for (size_t i = 0; i < 4; i++) {
            setpoint->command[i] = hyperbolic_tangent(u[i]);
        }
    }
    limit(setpoint);
    return problems;
}

uint32_t policy_weights_crc32(void)
{
    const unsigned char *bytes = (const unsigned char *)&policy_weights;
    uint32_t crc = 0xFFFFFFFFUL;
    for (size_t i = 0; i < sizeof policy_weights; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc >> 1) ^ ((crc & 1U) != 0U ? 0xEDB88320UL : 0UL);
        }
    }
    return crc ^ 0xFFFFFFFFUL;
}
