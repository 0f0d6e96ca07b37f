// Linear layers, layer normalisation, activations and attention of blocks of rows, with their gradients.
#pragma once

#include <cstring>

#include "vector.h"

namespace {

constexpr int W = WIDTH, H = HEADS, D = W / H;
constexpr int L = 2 * V;  // rows of a block
constexpr float EPSILON = 1e-5f;  // of torch.nn.LayerNorm
static_assert(W % V == 0 && W % 4 == 0 && W % H == 0, "width");

// Numbers of a block, feature by feature: `columns` = tokens x L next to each other, features `stride` apart.
struct Block {
    float* data;
    int stride;
    float* row(int feature) const { return data + (long)feature * stride; }
    Block at(int token) const { return {data + token * L, stride}; }
    Block from(int feature) const { return {row(feature), stride}; }
};

struct Linear {
    const float* weight;  // (out, in)
    const float* bias;
    int in, out;
};

// y[o][c] (+)= sum_k w(o, k) x[k][c], where w(o, k) = w[o * by_out + k * by_in]; OUT outputs and L columns at once.
template <int OUT>
inline void products(const float* w, int by_out, int by_in, const float* bias, Block x, Block y, int o, int ins,
                     int columns, bool add) {
    for (int c = 0; c < columns; c += L) {
        vec sum[OUT][2];
        for (int j = 0; j < OUT; j++)
            for (int v = 0; v < 2; v++) {
                sum[j][v] = bias ? all(bias[o + j]) : vec{};
                if (add) sum[j][v] += load(y.row(o + j) + c + v * V);
            }
        const float* from = x.data + c;
        const float* weights = w + (long)o * by_out;
        for (int k = 0; k < ins; k++, from += x.stride, weights += by_in) {
            const vec left = load(from), right = load(from + V);
            for (int j = 0; j < OUT; j++) {
                const vec scale = all(weights[j * by_out]);
                sum[j][0] += scale * left;
                sum[j][1] += scale * right;
            }
        }
        for (int j = 0; j < OUT; j++)
            for (int v = 0; v < 2; v++) store(y.row(o + j) + c + v * V, sum[j][v]);
    }
}

void product(const float* w, int by_out, int by_in, const float* bias, Block x, Block y, int outs, int ins, int columns,
             bool add) {
    int o = 0;
    for (; o + 4 <= outs; o += 4) products<4>(w, by_out, by_in, bias, x, y, o, ins, columns, add);
    for (; o < outs; o++) products<1>(w, by_out, by_in, bias, x, y, o, ins, columns, add);
}

// y (+)= weight x + bias
inline void forward(const Linear& layer, Block x, Block y, int columns, bool add = false) {
    product(layer.weight, layer.in, 1, layer.bias, x, y, layer.out, layer.in, columns, add);
}

// dx (+)= weight^T dy
inline void backward(const Linear& layer, Block dy, Block dx, int columns, bool add) {
    product(layer.weight, 1, layer.in, nullptr, dy, dx, layer.in, layer.out, columns, add);
}

// Gradients of a layer: weights with their inputs padded to whole vectors, biases with a vector of partial sums each.
struct Gradient {
    float* weight;  // (out, padded in)
    float* bias;    // (out, V)
};

inline int padded(int in) { return (in + V - 1) / V * V; }

#if defined(__AVX__) && !defined(__AVX512F__)
inline void transpose_tile(const float* from, int stride, float* to, int pitch) {
    vec a[8], b[8];
    for (int i = 0; i < 8; i++) a[i] = load(from + (long)i * stride);
    for (int i = 0; i < 8; i += 2) {
        b[i] = __builtin_shufflevector(a[i], a[i + 1], 0, 8, 2, 10, 4, 12, 6, 14);
        b[i + 1] = __builtin_shufflevector(a[i], a[i + 1], 1, 9, 3, 11, 5, 13, 7, 15);
    }
    for (int i = 0; i < 8; i += 4)
        for (int j = 0; j < 2; j++) {
            a[i + j] = __builtin_shufflevector(b[i + j], b[i + j + 2], 0, 1, 8, 9, 4, 5, 12, 13);
            a[i + j + 2] = __builtin_shufflevector(b[i + j], b[i + j + 2], 2, 3, 10, 11, 6, 7, 14, 15);
        }
    for (int j = 0; j < 4; j++) {
        store(to + (long)j * pitch, __builtin_shufflevector(a[j], a[j + 4], 0, 1, 2, 3, 8, 9, 10, 11));
        store(to + (long)(j + 4) * pitch, __builtin_shufflevector(a[j], a[j + 4], 4, 5, 6, 7, 12, 13, 14, 15));
    }
}
#else
inline void transpose_tile(const float* from, int stride, float* to, int pitch) {
    for (int i = 0; i < V; i++)
        for (int j = 0; j < V; j++) to[(long)j * pitch + i] = from[(long)i * stride + j];
}
#endif

// to[column][feature]; features beyond `ins` become zero.
void transpose(Block x, int ins, int columns, float* to) {
    const int pitch = padded(ins);
    for (int i = 0; i + V <= ins; i += V)
        for (int c = 0; c < columns; c += V) transpose_tile(x.row(i) + c, x.stride, to + (long)c * pitch + i, pitch);
    for (int i = ins / V * V; i < pitch; i++)
        for (int c = 0; c < columns; c++) to[(long)c * pitch + i] = i < ins ? x.row(i)[c] : 0.0f;
}

// weight[o][i] += sum_c dy[o][c] xt[c][i]; OUT outputs and IN vectors of inputs at once.
template <int OUT, int IN>
inline void outer(Block dy, int o, const float* xt, int pitch, int i, int columns, float* weight) {
    vec sum[OUT][IN];
    for (int j = 0; j < OUT; j++)
        for (int v = 0; v < IN; v++) sum[j][v] = load(weight + (long)(o + j) * pitch + i + v * V);
    const float* from = xt + i;
    for (int c = 0; c < columns; c++, from += pitch) {
        vec x[IN];
        for (int v = 0; v < IN; v++) x[v] = load(from + v * V);
        for (int j = 0; j < OUT; j++) {
            const vec scale = all(dy.row(o + j)[c]);
            for (int v = 0; v < IN; v++) sum[j][v] += scale * x[v];
        }
    }
    for (int j = 0; j < OUT; j++)
        for (int v = 0; v < IN; v++) store(weight + (long)(o + j) * pitch + i + v * V, sum[j][v]);
}

// Adds the layer's gradients, given its inputs column by column.
void accumulate(const Linear& layer, Block dy, const float* xt, int columns, const Gradient& to) {
    const int pitch = padded(layer.in);
    for (int o = 0; o < layer.out; o += 4) {
        int i = 0;
        for (; i + 2 * V <= pitch; i += 2 * V) outer<4, 2>(dy, o, xt, pitch, i, columns, to.weight);
        for (; i < pitch; i += V) outer<4, 1>(dy, o, xt, pitch, i, columns, to.weight);
    }
    for (int o = 0; o < layer.out; o++) {
        vec sum = load(to.bias + o * V);
        for (int c = 0; c < columns; c += V) sum += load(dy.row(o) + c);
        store(to.bias + o * V, sum);
    }
}

// What layer normalisation keeps: x without mean and of unit spread, and 1 / spread.
void normalise(Block x, Block unit, float* rstd, int columns) {
    for (int c = 0; c < columns; c += L) {
        vec mean[2] = {}, spread[2] = {};
        for (int i = 0; i < W; i++)
            for (int v = 0; v < 2; v++) mean[v] += load(x.row(i) + c + v * V);
        for (int v = 0; v < 2; v++) mean[v] *= 1.0f / W;
        for (int i = 0; i < W; i++)
            for (int v = 0; v < 2; v++) {
                const vec off = load(x.row(i) + c + v * V) - mean[v];
                spread[v] += off * off;
            }
        for (int v = 0; v < 2; v++) {
            spread[v] = 1.0f / root(spread[v] * (1.0f / W) + EPSILON);
            store(rstd + c + v * V, spread[v]);
        }
        for (int i = 0; i < W; i++)
            for (int v = 0; v < 2; v++)
                store(unit.row(i) + c + v * V, (load(x.row(i) + c + v * V) - mean[v]) * spread[v]);
    }
}

void scale(const Linear& norm, Block unit, Block y, int columns) {
    for (int i = 0; i < W; i++)
        for (int c = 0; c < columns; c += V)
            store(y.row(i) + c, load(unit.row(i) + c) * norm.weight[i] + norm.bias[i]);
}

// dx += the gradient through `scale` and `normalise`; `dy` is used up. `sums`: V partial sums of each gain and shift.
void normalise_backward(const Linear& norm, Block unit, const float* rstd, Block dy, Block dx, int columns,
                        const Gradient* sums) {
    for (int i = 0; i < W; i++) {
        vec gain = {}, shift = {};
        for (int c = 0; c < columns; c += V) {
            const vec g = load(dy.row(i) + c);
            gain += g * load(unit.row(i) + c);
            shift += g;
            store(dy.row(i) + c, g * norm.weight[i]);
        }
        if (sums) {
            store(sums->weight + i * V, load(sums->weight + i * V) + gain);
            store(sums->bias + i * V, load(sums->bias + i * V) + shift);
        }
    }
    for (int c = 0; c < columns; c += L) {
        vec mean[2] = {}, slope[2] = {}, scale[2];
        for (int i = 0; i < W; i++)
            for (int v = 0; v < 2; v++) {
                const vec g = load(dy.row(i) + c + v * V);
                mean[v] += g;
                slope[v] += g * load(unit.row(i) + c + v * V);
            }
        for (int v = 0; v < 2; v++) {
            mean[v] *= 1.0f / W;
            slope[v] *= 1.0f / W;
            scale[v] = load(rstd + c + v * V);
        }
        for (int i = 0; i < W; i++)
            for (int v = 0; v < 2; v++) {
                float* to = dx.row(i) + c + v * V;
                const vec off = load(dy.row(i) + c + v * V) - mean[v] - load(unit.row(i) + c + v * V) * slope[v];
                store(to, load(to) + off * scale[v]);
            }
    }
}

// Multi-head attention of `queries` over `keys` tokens; `present` [key][row] is 1 or 0. Keeps the weights
// [head][query][key][row]. A row without any key gets zeros.
void attend(Block q, int queries, Block k, Block v, int keys, const float* present, float* weights, Block out) {
    const float factor = 1.0f / __builtin_sqrtf((float)D);
    for (int h = 0; h < H; h++)
        for (int t = 0; t < queries; t++) {
            float* p = weights + (long)(h * queries + t) * keys * L;
            vec top[2] = {all(-3e38f), all(-3e38f)};
            for (int s = 0; s < keys; s++) {
                vec logit[2] = {};
                for (int d = h * D; d < (h + 1) * D; d++)
                    for (int u = 0; u < 2; u++)
                        logit[u] += load(q.row(d) + t * L + u * V) * load(k.row(d) + s * L + u * V);
                for (int u = 0; u < 2; u++) {
                    const ivec here = load(present + s * L + u * V) > all(0.0f);
                    logit[u] = pick(here, logit[u] * factor, all(-3e38f));
                    top[u] = larger(logit[u], top[u]);
                    store(p + s * L + u * V, logit[u]);
                }
            }
            vec total[2] = {};
            for (int s = 0; s < keys; s++)
                for (int u = 0; u < 2; u++) {
                    const vec share =
                        exponential(load(p + s * L + u * V) - top[u]) * load(present + s * L + u * V);
                    total[u] += share;
                    store(p + s * L + u * V, share);
                }
            for (int u = 0; u < 2; u++) total[u] = pick(total[u] == all(0.0f), all(0.0f), 1.0f / total[u]);
            for (int s = 0; s < keys; s++)
                for (int u = 0; u < 2; u++) store(p + s * L + u * V, load(p + s * L + u * V) * total[u]);
            for (int d = h * D; d < (h + 1) * D; d++) {
                vec sum[2] = {};
                for (int s = 0; s < keys; s++)
                    for (int u = 0; u < 2; u++)
                        sum[u] += load(p + s * L + u * V) * load(v.row(d) + s * L + u * V);
                for (int u = 0; u < 2; u++) store(out.row(d) + t * L + u * V, sum[u]);
            }
        }
}

// Gradients of `attend`; those of queries, keys and values are written, not added.
void attend_backward(Block q, int queries, Block k, Block v, int keys, const float* weights, Block dout, Block dq,
                     Block dk, Block dv, float* slopes) {
    const float factor = 1.0f / __builtin_sqrtf((float)D);
    for (int h = 0; h < H; h++) {
        for (int d = h * D; d < (h + 1) * D; d++) {
            std::memset(dk.row(d), 0, sizeof(float) * keys * L);
            std::memset(dv.row(d), 0, sizeof(float) * keys * L);
        }
        for (int t = 0; t < queries; t++) {
            const float* p = weights + (long)(h * queries + t) * keys * L;
            vec mean[2] = {};
            for (int s = 0; s < keys; s++) {
                vec slope[2] = {};
                for (int d = h * D; d < (h + 1) * D; d++)
                    for (int u = 0; u < 2; u++)
                        slope[u] += load(dout.row(d) + t * L + u * V) * load(v.row(d) + s * L + u * V);
                for (int u = 0; u < 2; u++) {
                    mean[u] += slope[u] * load(p + s * L + u * V);
                    store(slopes + s * L + u * V, slope[u]);
                }
            }
            for (int s = 0; s < keys; s++)
                for (int u = 0; u < 2; u++) {
                    float* to = slopes + s * L + u * V;
                    store(to, (load(to) - mean[u]) * load(p + s * L + u * V) * factor);
                }
            for (int d = h * D; d < (h + 1) * D; d++) {
                vec sum[2] = {};
                for (int s = 0; s < keys; s++)
                    for (int u = 0; u < 2; u++) {
                        const int at = s * L + u * V, own = t * L + u * V;
                        const vec slope = load(slopes + at);
                        sum[u] += slope * load(k.row(d) + at);
                        store(dk.row(d) + at, load(dk.row(d) + at) + slope * load(q.row(d) + own));
                        store(dv.row(d) + at, load(dv.row(d) + at) + load(p + at) * load(dout.row(d) + own));
                    }
                for (int u = 0; u < 2; u++) store(dq.row(d) + t * L + u * V, sum[u]);
            }
        }
    }
}

void activate(Block x, Block slope, int columns) {
    for (int i = 0; i < W; i++)
        for (int c = 0; c < columns; c += V) {
            vec s;
            store(x.row(i) + c, gelu(load(x.row(i) + c), &s));
            store(slope.row(i) + c, s);
        }
}

void multiply(Block x, Block by, int columns) {
    for (int i = 0; i < W; i++)
        for (int c = 0; c < columns; c += V) store(x.row(i) + c, load(x.row(i) + c) * load(by.row(i) + c));
}

}  // namespace
