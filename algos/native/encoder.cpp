// The attention encoder of algos/encoder.py (paper, Sec. V-C1), forward and backward, for a handful of tokens on a CPU.
//
// Rows (one per drone) are taken L at a time, and every number of a block lies with its L rows innermost:
// [feature][token][row]. So each operation, the attention too, is a loop of whole vector registers over rows, and the
// products with 32 x 32 weights read their operands from the first-level cache. A token that no row of the block has is
// left out: nobody may look at it, and what it would become is not used.
//
// Built for one WIDTH and HEADS by algos/native/library.py. All tensors are contiguous float32, masks are bytes.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <numeric>
#include <vector>

#include "layers.h"

namespace {

constexpr int GROUPS = 4;  // self, drones, dynamic, static

struct Shape {
    int32_t rows, drones, balls;  // drones, balls: tokens of the other drones and of balls
    int32_t dims[GROUPS];         // numbers of a token, by group
    int32_t two_layers;           // embeddings: Linear, ELU, Linear, or one Linear

    int tokens() const { return 1 + drones + balls + 1; }
    int count(int group) const { return group == 1 ? drones : group == 2 ? balls : 1; }
    int widest() const { return std::max(W, *std::max_element(dims, dims + GROUPS)); }
};

// Layers in the order of the module's parameters, which lie one behind the other, weights (out, in) before biases (out);
// a layer normalisation is one without inputs.
enum Part { EMBED, NORM_MIX = 2 * GROUPS, MIX_QUERY, MIX_KEYS, MIX_OUT, NORM_TOKENS, FEED_IN, FEED_OUT, NORM_SHARED,
            GATHER_QUERY, GATHER_KEYS, GATHER_OUT, NORM_PAIR, PAIR_IN, PAIR_OUT, PARTS };

void describe(const Shape& s, const float* parameters, Linear* parts) {
    for (int g = 0; g < GROUPS; g++) {
        parts[EMBED + 2 * g] = {nullptr, nullptr, s.dims[g], W};
        parts[EMBED + 2 * g + 1] = {nullptr, nullptr, W, s.two_layers ? W : 0};
    }
    for (int i = NORM_MIX; i < PARTS; i++) parts[i] = {nullptr, nullptr, W, W};
    for (int i : {NORM_MIX, NORM_TOKENS, NORM_SHARED, NORM_PAIR}) parts[i].in = 0;
    for (int i : {MIX_KEYS, GATHER_KEYS}) parts[i].out = 2 * W;
    for (int i = 0; i < PARTS; i++) {
        parts[i].weight = parameters;
        parts[i].bias = parameters += parts[i].out * std::max(parts[i].in, 1);
        parameters += parts[i].out;
    }
}


// Numbers of a weight's gradient while it is summed: inputs padded, or V partial sums of a gain.
long summed(const Linear& part) { return (long)part.out * (part.in ? padded(part.in) : V); }

// What a block of rows keeps for its gradient, and which tokens it has.
struct Saved {
    int count[GROUPS], first[GROUPS], active;  // tokens that any row has, by group
    int* balls;                                // their numbers
    float* present;                            // [token][row]
    Block raw[GROUPS], hidden, unit[4], query, keys, attended, act, slope, query2, keys2, attended2, act2, slope2;
    float *rstd[4], *weights, *weights2;
};

struct Memory {
    float* data;
    long used = 0;
    float* take(long count) {
        float* here = data ? data + used : nullptr;
        used += (count + 15) / 16 * 16;
        return here;
    }
    Block block(int features, int columns) { return {take((long)features * columns), columns}; }
};

// Sets out a block's memory for `tokens` tokens, of which `count` by group; returns how many floats it takes.
long layout(float* memory, const Shape& s, int tokens, const int* count, Saved& b) {
    Memory m{memory};
    const int columns = tokens * L;
    b.present = m.take(columns);
    for (int g = 0; g < GROUPS; g++) b.raw[g] = m.block(s.dims[g], count[g] * L);
    b.hidden = m.block(W, columns);
    for (int i = 0; i < 3; i++) b.unit[i] = m.block(W, columns), b.rstd[i] = m.take(columns);
    b.unit[3] = m.block(W, 2 * L), b.rstd[3] = m.take(2 * L);
    b.query = m.block(W, columns), b.keys = m.block(2 * W, columns), b.attended = m.block(W, columns);
    b.weights = m.take((long)H * tokens * columns);
    b.act = m.block(W, columns), b.slope = m.block(W, columns);
    b.query2 = m.block(W, L), b.keys2 = m.block(2 * W, columns), b.attended2 = m.block(W, L);
    b.weights2 = m.take((long)H * columns);
    b.act2 = m.block(W, 2 * L), b.slope2 = m.block(W, 2 * L);
    return m.used;
}

// Which tokens the rows from `row` on have, and where they are kept.
void survey(const Shape& s, const uint8_t* const* masks, int row, float* memory, int* balls, Saved& b) {
    const int rows = std::min(L, s.rows - row);
    b.balls = balls;
    b.count[0] = 1, b.count[1] = s.drones, b.count[2] = 0, b.count[3] = 0;
    for (int t = 0; t < s.balls; t++)
        for (int l = 0; l < rows; l++)
            if (masks[0][(long)(row + l) * s.balls + t]) {
                balls[b.count[2]++] = t;
                break;
            }
    for (int l = 0; l < rows; l++)
        if (masks[1][row + l]) b.count[3] = 1;
    b.active = 0;
    for (int g = 0; g < GROUPS; g++) b.first[g] = b.active, b.active += b.count[g];
    layout(memory, s, b.active, b.count, b);
}

void read(const Shape& s, const float* const* inputs, const uint8_t* const* masks, int row, Saved& b) {
    const int rows = std::min(L, s.rows - row);
    for (int g = 0; g < GROUPS; g++)
        for (int j = 0; j < b.count[g]; j++) {
            const int token = g == 2 ? b.balls[j] : j;
            float* present = b.present + (b.first[g] + j) * L;
            for (int l = 0; l < L; l++) {
                const long at = (long)(row + l) * s.count(g) + token;
                const bool here = l < rows && (g < 2 || masks[g - 2][at]);
                present[l] = here || g < 2;
                const float* from = inputs[g] + at * s.dims[g];
                for (int i = 0; i < s.dims[g]; i++) b.raw[g].row(i)[j * L + l] = here ? from[i] : 0.0f;
            }
        }
}

// Absent tokens become zero.
void mask(const Saved& b, Block x) {
    for (int i = 0; i < W; i++)
        for (int c = b.first[2] * L; c < b.active * L; c += V) store(x.row(i) + c, load(x.row(i) + c) * load(b.present + c));
}

void forward_block(const Shape& s, const Linear* p, const Saved& b, Memory scratch, Block pair) {
    const int columns = b.active * L;
    Block x = scratch.block(W, columns), n = scratch.block(W, std::max(columns, 2 * L));
    for (int g = 0; g < GROUPS; g++) {
        const int own = b.count[g] * L;
        const Linear* embed = p + EMBED + 2 * g;
        if (s.two_layers) {
            const Block hidden = b.hidden.at(b.first[g]);
            forward(embed[0], b.raw[g], hidden, own);
            for (int i = 0; i < W; i++)
                for (int c = 0; c < own; c += V) store(hidden.row(i) + c, elu(load(hidden.row(i) + c)));
            forward(embed[1], hidden, x.at(b.first[g]), own);
        } else {
            forward(embed[0], b.raw[g], x.at(b.first[g]), own);
        }
    }
    mask(b, x);

    normalise(x, b.unit[0], b.rstd[0], columns);
    scale(p[NORM_MIX], b.unit[0], n, columns);
    forward(p[MIX_QUERY], n, b.query, columns);
    forward(p[MIX_KEYS], n, b.keys, columns);
    attend(b.query, b.active, b.keys, b.keys.from(W), b.active, b.present, b.weights, b.attended);
    forward(p[MIX_OUT], b.attended, x, columns, true);

    normalise(x, b.unit[1], b.rstd[1], columns);
    scale(p[NORM_TOKENS], b.unit[1], n, columns);
    forward(p[FEED_IN], n, b.act, columns);
    activate(b.act, b.slope, columns);
    forward(p[FEED_OUT], b.act, x, columns, true);

    normalise(x, b.unit[2], b.rstd[2], columns);
    scale(p[NORM_SHARED], b.unit[2], n, columns);
    forward(p[GATHER_QUERY], n, b.query2, L);
    forward(p[GATHER_KEYS], n.at(1), b.keys2, columns - L);
    attend(b.query2, 1, b.keys2, b.keys2.from(W), b.active - 1, b.present + L, b.weights2, b.attended2);
    for (int i = 0; i < W; i++)
        for (int t = 0; t < 2; t++) std::memcpy(pair.row(i) + t * L, x.row(i), sizeof(float) * L);
    forward(p[GATHER_OUT], b.attended2, pair.at(1), L, true);

    normalise(pair, b.unit[3], b.rstd[3], 2 * L);
    scale(p[NORM_PAIR], b.unit[3], n, 2 * L);
    forward(p[PAIR_IN], n, b.act2, 2 * L);
    activate(b.act2, b.slope2, 2 * L);
    forward(p[PAIR_OUT], b.act2, pair, 2 * L, true);
}

// Gradients of a block given that of `pair`, which is used up. `sums` are those of parameters, none where they are not
// wanted; `dx` receives that of the embedded tokens.
struct Reverse {
    const Shape& s;
    const Linear* p;
    const Saved& b;
    const Gradient* sums;
    float *turned, *slopes;
    Block n, dy, dn, dkeys;

    // Through layer `part`, which read `input`: its own gradient, and (added to) that of its input.
    void layer(int part, Block input, Block out, Block in, int columns, bool add = false) {
        if (sums) {
            transpose(input, p[part].in, columns, turned);
            accumulate(p[part], out, turned, columns, sums[part]);
        }
        if (in.data) backward(p[part], out, in, columns, add);
    }

    void norm(int part, Block unit, const float* rstd, Block out, Block in, int columns) {
        normalise_backward(p[part], unit, rstd, out, in, columns, sums ? &sums[part] : nullptr);
    }

    void pair_and_gather(Block dpair, Block dx) {
        const int others = (b.active - 1) * L;
        layer(PAIR_OUT, b.act2, dpair, dy, 2 * L);
        multiply(dy, b.slope2, 2 * L);
        scale(p[NORM_PAIR], b.unit[3], n, 2 * L);
        layer(PAIR_IN, n, dy, dn, 2 * L);
        norm(NORM_PAIR, b.unit[3], b.rstd[3], dn, dpair, 2 * L);

        for (int i = 0; i < W; i++) {
            std::memset(dx.row(i) + L, 0, sizeof(float) * others);
            for (int l = 0; l < L; l += V) store(dx.row(i) + l, load(dpair.row(i) + l) + load(dpair.row(i) + L + l));
        }
        layer(GATHER_OUT, b.attended2, dpair.at(1), dn, L);
        attend_backward(b.query2, 1, b.keys2, b.keys2.from(W), b.active - 1, b.weights2, dn, dy, dkeys, dkeys.from(W),
                        slopes);
        scale(p[NORM_SHARED], b.unit[2], n, others + L);
        layer(GATHER_QUERY, n, dy, dn, L);
        layer(GATHER_KEYS, n.at(1), dkeys, dn.at(1), others);
        norm(NORM_SHARED, b.unit[2], b.rstd[2], dn, dx, others + L);
    }

    void feed_and_mix(Block dx) {
        const int columns = b.active * L;
        layer(FEED_OUT, b.act, dx, dy, columns);
        multiply(dy, b.slope, columns);
        scale(p[NORM_TOKENS], b.unit[1], n, columns);
        layer(FEED_IN, n, dy, dn, columns);
        norm(NORM_TOKENS, b.unit[1], b.rstd[1], dn, dx, columns);

        layer(MIX_OUT, b.attended, dx, dn, columns);
        attend_backward(b.query, b.active, b.keys, b.keys.from(W), b.active, b.weights, dn, dy, dkeys, dkeys.from(W),
                        slopes);
        scale(p[NORM_MIX], b.unit[0], n, columns);
        layer(MIX_QUERY, n, dy, dn, columns);
        layer(MIX_KEYS, n, dkeys, dn, columns, true);
        norm(NORM_MIX, b.unit[0], b.rstd[0], dn, dx, columns);
        mask(b, dx);
    }

    // Gradients of embeddings and of what they read; `draw[g]` has no data where the latter is not wanted.
    void embeddings(Block dx, const Block* draw) {
        for (int g = 0; g < GROUPS; g++) {
            const int own = b.count[g] * L, part = EMBED + 2 * g;
            Block out = dx.at(b.first[g]);
            if (s.two_layers) {
                const Block hidden = b.hidden.at(b.first[g]);
                layer(part + 1, hidden, out, dy, own);
                for (int i = 0; i < W; i++)
                    for (int c = 0; c < own; c += V) {
                        const vec h = load(hidden.row(i) + c);
                        store(dy.row(i) + c, load(dy.row(i) + c) * pick(h > all(0.0f), all(1.0f), h + 1.0f));
                    }
                out = dy;
            }
            layer(part, b.raw[g], out, draw[g], own);
        }
    }
};

// Input gradients of a block's rows back into (rows, tokens, numbers); tokens that were left out get zeros.
void write(const Shape& s, int row, const Saved& b, const Block* draw, float* const* dinputs) {
    const int rows = std::min(L, s.rows - row);
    for (int g = 0; g < GROUPS; g++) {
        const long each = (long)s.count(g) * s.dims[g];
        if (b.count[g] < s.count(g)) std::memset(dinputs[g] + row * each, 0, sizeof(float) * rows * each);
        for (int j = 0; j < b.count[g]; j++)
            for (int l = 0; l < rows; l++) {
                float* to = dinputs[g] + (row + l) * each + (g == 2 ? b.balls[j] : j) * s.dims[g];
                for (int i = 0; i < s.dims[g]; i++) to[i] = draw[g].row(i)[j * L + l];
            }
    }
}

// Working memory of this thread, enough for either direction.
float* workspace(const Shape& s, const Linear* parts) {
    static thread_local std::vector<float> memory;
    long size = 256 + 4L * W * L;
    for (int k = 0; k < PARTS; k++) size += summed(parts[k]) + (long)parts[k].out * V + 32;
    for (int g = 0; g < GROUPS; g++) size += (long)s.dims[g] * s.count(g) * L + 16;
    size += (long)s.tokens() * L * (7 * W + padded(s.widest()) + 2);
    if ((long)memory.size() < size) memory.resize(size);
    return memory.data();
}

// Sums over lanes and without padding, in the order of the parameters.
void collect(const Linear* parts, const Gradient* sums, float* out) {
    for (int k = 0; k < PARTS; k++) {
        const Linear& part = parts[k];
        for (int o = 0; o < part.out; o++)
            if (part.in) {
                std::memcpy(out, sums[k].weight + (long)o * padded(part.in), sizeof(float) * part.in);
                out += part.in;
            } else {
                *out++ = std::accumulate(sums[k].weight + o * V, sums[k].weight + (o + 1) * V, 0.0f);
            }
        for (int o = 0; o < part.out; o++)
            *out++ = std::accumulate(sums[k].bias + o * V, sums[k].bias + (o + 1) * V, 0.0f);
    }
}

}  // namespace

extern "C" {

int32_t rows_of_a_block() { return L; }

// Floats that a block of rows keeps for its gradient.
int64_t saved_floats(const Shape* s) {
    const int count[GROUPS] = {1, s->drones, s->balls, 1};
    Saved b;
    return layout(nullptr, *s, s->tokens(), count, b);
}

// Features (rows, 2 W) of groups (rows, tokens, dims). `saved`: for every block what its gradient needs, or of one block
// where `keep` is 0.
void encode(const Shape* s, const float* const* inputs, const uint8_t* const* masks, const float* parameters,
            float* out, float* saved, int32_t keep) {
    Linear parts[PARTS];
    describe(*s, parameters, parts);
    float* scratch = workspace(*s, parts);
    const long size = saved_floats(s);
    std::vector<int> balls(s->balls);
    for (int row = 0; row < s->rows; row += L) {
        Saved b;
        survey(*s, masks, row, keep ? saved + row / L * size : saved, balls.data(), b);
        read(*s, inputs, masks, row, b);
        Memory m{scratch};
        Block pair = m.block(W, 2 * L);
        forward_block(*s, parts, b, m, pair);
        for (int l = 0; l < std::min(L, s->rows - row); l++)
            for (int t = 0; t < 2; t++)
                for (int i = 0; i < W; i++) out[((long)(row + l) * 2 + t) * W + i] = pair.row(i)[t * L + l];
    }
}

// The gradient of `encode`: of its groups (`dinputs`, or none) and of its parameters one behind the other
// (`dparameters`, or none), given that of its features.
void encode_backward(const Shape* s, const uint8_t* const* masks, const float* parameters, float* saved,
                     const float* dout, float* const* dinputs, float* dparameters) {
    Linear parts[PARTS];
    describe(*s, parameters, parts);
    float* scratch = workspace(*s, parts);
    Memory m{scratch};
    Gradient sums[PARTS];
    for (int k = 0; k < PARTS; k++) sums[k] = {m.take(summed(parts[k])), m.take((long)parts[k].out * V)};
    std::memset(scratch, 0, sizeof(float) * m.used);
    const long size = saved_floats(s);
    const Memory rest = m;
    std::vector<int> balls(s->balls);
    for (int row = 0; row < s->rows; row += L) {
        Saved b;
        survey(*s, masks, row, saved + row / L * size, balls.data(), b);
        m = rest;
        const int columns = b.active * L, most = std::max(columns, 2 * L);
        Block dpair = m.block(W, 2 * L), dx = m.block(W, columns), draw[GROUPS] = {};
        for (int g = 0; g < GROUPS && dinputs; g++) draw[g] = m.block(s->dims[g], b.count[g] * L);
        float* turned = m.take((long)most * padded(s->widest()));
        float* slopes = m.take(columns);
        Reverse reverse{*s,     parts,            b,                dparameters ? sums : nullptr, turned,
                        slopes, m.block(W, most), m.block(W, most), m.block(W, most),             m.block(2 * W, columns)};
        for (int t = 0; t < 2; t++)
            for (int i = 0; i < W; i++)
                for (int l = 0; l < L; l++)
                    dpair.row(i)[t * L + l] = row + l < s->rows ? dout[((long)(row + l) * 2 + t) * W + i] : 0.0f;
        reverse.pair_and_gather(dpair, dx);
        reverse.feed_and_mix(dx);
        reverse.embeddings(dx, draw);
        if (dinputs) write(*s, row, b, draw, dinputs);
    }
    if (dparameters) collect(parts, sums, dparameters);
}

}  // extern "C"
