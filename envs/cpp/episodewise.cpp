// The frame of a piece of the world (envs/episodewise.py): episodes go through it a vector register at a time.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "vector.h"

namespace {

constexpr int INPUTS = $inputs, OUTPUTS = $outputs, WANTED = $wanted;        // numbers of an episode
constexpr int TENSORS = $tensors, RESULTS = $results, GRADIENTS = $gradients;
const int input_sizes[] = {$input_sizes}, input_firsts[] = {$input_firsts};  // of each tensor's numbers in an episode's
const int output_sizes[] = {$output_sizes};
const int gradient_sizes[] = {$gradient_sizes}, gradient_firsts[] = {$gradient_firsts};
const int wanted_inputs[] = {$wanted_inputs};  // inputs whose gradients are asked for
const int carried[] = {$carried};  // the input that an output replaces when the piece is repeated

struct Array {
    void* data;
    int64_t by_episode, by_element;
    int64_t kind;  // 0 float, 1 int64, 2 bool
};

inline float number(const Array& from, int64_t at) {
    if (from.kind == 0) return static_cast<const float*>(from.data)[at];
    if (from.kind == 1) return static_cast<float>(static_cast<const int64_t*>(from.data)[at]);
    return static_cast<const uint8_t*>(from.data)[at];
}

// Numbers of the episodes from `first` on; the last one fills the register where there are no more.
inline void take(const Array& from, int size, int64_t first, int64_t episodes, vec* to) {
    for (int i = 0; i < size; i++) {
        const int64_t at = i * from.by_element;
        if (!from.data) {
            to[i] = vec{};
        } else if (from.kind == 0 && from.by_episode == 1 && first + V <= episodes) {
            to[i] = load(static_cast<const float*>(from.data) + at + first);
        } else {
            float lanes[V];
            for (int l = 0; l < V; l++)
                lanes[l] = number(from, at + std::min<int64_t>(first + l, episodes - 1) * from.by_episode);
            to[i] = load(lanes);
        }
    }
}

inline void put(const Array& to, int size, int64_t first, int64_t episodes, const vec* from) {
    for (int i = 0; i < size; i++) {
        const int64_t at = i * to.by_element;
        if (to.kind == 0 && to.by_episode == 1 && first + V <= episodes) {
            store(static_cast<float*>(to.data) + at + first, from[i]);
            continue;
        }
        float lanes[V];
        store(lanes, from[i]);
        for (int l = 0; l < V && first + l < episodes; l++) {
            const int64_t place = at + (first + l) * to.by_episode;
            if (to.kind == 0) static_cast<float*>(to.data)[place] = lanes[l];
            if (to.kind == 1) static_cast<int64_t*>(to.data)[place] = static_cast<int64_t>(lanes[l]);
            if (to.kind == 2) static_cast<uint8_t*>(to.data)[place] = lanes[l] != 0;
        }
    }
}

void value(const vec* in, vec* out) {
$value
}

void gradient(const vec* in, const vec* dout, vec* out) {
$gradient
}

void take_inputs(const Array* from, int64_t first, int64_t episodes, vec* to) {
    for (int k = 0; k < TENSORS; k++) take(from[k], input_sizes[k], first, episodes, to + input_firsts[k]);
}

void repeat_once(vec* in, const vec* out) {
    for (int k = 0; k < OUTPUTS; k++)
        if (carried[k] >= 0) in[carried[k]] = out[k];
}

}  // namespace

extern "C" {

void forward(int32_t episodes, int32_t repeat, const Array* inputs, const Array* outputs) {
    vec in[INPUTS + 1], out[OUTPUTS + 1];
    for (int64_t first = 0; first < episodes; first += V) {
        take_inputs(inputs, first, episodes, in);
        for (int r = 0; r < repeat; r++) {
            value(in, out);
            repeat_once(in, out);
        }
        for (int k = 0, at = 0; k < RESULTS; at += output_sizes[k++])
            put(outputs[k], output_sizes[k], first, episodes, out + at);
    }
}

void backward(int32_t episodes, int32_t repeat, const Array* inputs, const Array* slopes, const Array* gradients) {
    std::vector<float> memory((size_t)repeat * INPUTS * V + V);
    vec* in = reinterpret_cast<vec*>(memory.data());
    vec out[OUTPUTS + 1], dout[OUTPUTS + 1], din[WANTED + 1], sum[INPUTS + 1];
    for (int64_t first = 0; first < episodes; first += V) {
        take_inputs(inputs, first, episodes, in);
        for (int r = 1; r < repeat; r++) {
            std::copy(in + (r - 1) * INPUTS, in + r * INPUTS, in + r * INPUTS);
            value(in + (r - 1) * INPUTS, out);
            repeat_once(in + r * INPUTS, out);
        }
        for (int k = 0, at = 0; k < RESULTS; at += output_sizes[k++])
            take(slopes[k], output_sizes[k], first, episodes, dout + at);
        std::fill(sum, sum + INPUTS, vec{});
        for (int r = repeat - 1; r >= 0; r--) {
            gradient(in + r * INPUTS, dout, din);
            for (int k = 0; k < WANTED; k++) sum[wanted_inputs[k]] += din[k];
            if (r == 0) break;
            for (int k = 0; k < OUTPUTS; k++) {
                dout[k] = carried[k] < 0 ? vec{} : sum[carried[k]];
                if (carried[k] >= 0) sum[carried[k]] = vec{};
            }
        }
        for (int k = 0; k < GRADIENTS; k++)
            put(gradients[k], gradient_sizes[k], first, episodes, sum + gradient_firsts[k]);
    }
}

}  // extern "C"
