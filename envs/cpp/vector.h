// Vector registers by GCC's and Clang's vector extensions, and the functions of numbers that networks need.
#pragma once

#include <cstdint>

namespace {

#if defined(__AVX512F__)
constexpr int V = 16;
#elif defined(__AVX__)
constexpr int V = 8;
#else
constexpr int V = 4;
#endif

typedef float vec __attribute__((vector_size(4 * V), aligned(4), may_alias));
typedef int32_t ivec __attribute__((vector_size(4 * V), aligned(4), may_alias));

inline vec load(const float* p) { return *reinterpret_cast<const vec*>(p); }
inline void store(float* p, vec x) { *reinterpret_cast<vec*>(p) = x; }
inline vec all(float x) { return x - vec{}; }
inline vec pick(ivec mask, vec yes, vec no) { return (vec)((mask & (ivec)yes) | (~mask & (ivec)no)); }
inline vec larger(vec a, vec b) { return pick(a < b, b, a); }
inline vec smaller(vec a, vec b) { return pick(a > b, b, a); }
inline vec magnitude(vec x) { return (vec)((ivec)x & 0x7fffffff); }
inline ivec truth(int yes) { return ivec{} - yes; }

inline vec root(vec x) {
    vec y;
    for (int l = 0; l < V; l++) y[l] = __builtin_sqrtf(x[l]);
    return y;
}

// e^x to 2 units in the last place; 0 below -87. NaN stays NaN.
inline vec exponential(vec x) {
    const vec low = all(-87.0f), high = all(88.0f);
    x = pick(x < low, low, pick(x > high, high, x));
    const vec scaled = x * 1.44269504f;
    const ivec n = __builtin_convertvector(scaled + pick(scaled < all(0.0f), all(-0.5f), all(0.5f)), ivec);
    const vec whole = __builtin_convertvector(n, vec);
    const vec r = (x - whole * 0.693359375f) + whole * 2.12194440e-4f;
    vec p = all(1.9875691500e-4f);
    p = p * r + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    p = p * (r * r) + r + 1.0f;
    return p * (vec)((n + 127) << 23);
}

// Sine and cosine, whole turns of pi taken away in two parts: error below 2e-7 up to some hundred radians.
inline vec sine_of_rest(vec r) {
    const vec square = r * r;
    vec p = all(-2.3889859e-8f);
    p = p * square + 2.7525562e-6f;
    p = p * square - 1.9840874e-4f;
    p = p * square + 8.3333310e-3f;
    p = p * square - 1.6666667e-1f;
    return r + r * square * p;
}

inline vec sine(vec x) {
    const vec turns = x * 0.318309886f;
    const ivec n = __builtin_convertvector(turns + pick(turns < all(0.0f), all(-0.5f), all(0.5f)), ivec);
    const vec whole = __builtin_convertvector(n, vec);
    const vec y = sine_of_rest((x - whole * 3.140625f) - whole * 9.67653589793e-4f);
    return (vec)((ivec)y ^ (n << 31));
}

inline vec cosine(vec x) {  // the sine of x + pi / 2: whole turns are odd halves
    const vec turns = x * 0.318309886f - 0.5f;
    const ivec n = __builtin_convertvector(turns + pick(turns < all(0.0f), all(-0.5f), all(0.5f)), ivec);
    const vec half = __builtin_convertvector(n, vec) + 0.5f;
    const vec y = sine_of_rest((x - half * 3.140625f) - half * 9.67653589793e-4f);
    return (vec)((ivec)y ^ ((n + 1) << 31));
}

// x Phi(x) and its derivative, Phi by Abramowitz and Stegun 7.1.26: error below 2e-7.
inline vec gelu(vec x, vec* slope) {
    const vec size = pick(x < all(0.0f), -x, x) * 0.70710678f;
    const vec t = 1.0f / (1.0f + 0.3275911f * size);
    const vec bell = exponential(-size * size);
    vec p = all(1.061405429f);
    p = p * t - 1.453152027f;
    p = p * t + 1.421413741f;
    p = p * t - 0.284496736f;
    p = p * t + 0.254829592f;
    const vec tail = 0.5f * p * t * bell;
    const vec phi = pick(x < all(0.0f), tail, 1.0f - tail);
    *slope = phi + x * bell * 0.39894228f;
    return x * phi;
}

inline vec elu(vec x) { return pick(x > all(0.0f), x, exponential(x) - 1.0f); }

}  // namespace
