// The vectors of one instruction set and the few operations the kernels need on them.
//
// Included by the sources that are compiled once per instruction set. Everything here is static,
// and those sources use no std:: templates: a copy shared by the linker could be the AVX-512 one.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

#define GSYN_INLINE static inline __attribute__((always_inline))

namespace gsyn {
namespace GSYN_VARIANT {

// ---- 4 lanes: SSE2 on x86-64, plain vector extensions elsewhere
typedef float Float4 __attribute__((vector_size(16)));
typedef int32_t Int4 __attribute__((vector_size(16)));

GSYN_INLINE Int4 less(Float4 a, Float4 b) { return a < b; }
GSYN_INLINE Int4 at_least(Float4 a, Float4 b) { return a >= b; }
GSYN_INLINE Int4 equal(Float4 a, Float4 b) { return a == b; }
GSYN_INLINE Int4 both(Int4 a, Int4 b) { return a & b; }
GSYN_INLINE Int4 without(Int4 a, Int4 b) { return a & ~b; }
GSYN_INLINE Float4 select(Int4 mask, Float4 a, Float4 b) { return mask ? a : b; }
GSYN_INLINE Float4 kept(Int4 mask, Float4 a) { return (Float4)(mask & (Int4)a); }
GSYN_INLINE Float4 negated(Int4 mask, Float4 a) { return (Float4)((Int4)a ^ (mask & INT32_MIN)); }
#if defined(__SSE2__)
GSYN_INLINE bool any(Int4 mask) { return _mm_movemask_ps((__m128)mask) != 0; }
GSYN_INLINE Float4 smaller(Float4 a, Float4 b) { return _mm_min_ps(a, b); }
GSYN_INLINE Float4 larger(Float4 a, Float4 b) { return _mm_max_ps(a, b); }
GSYN_INLINE Float4 root(Float4 a) { return _mm_sqrt_ps(a); }
#else
GSYN_INLINE bool any(Int4 mask) { return (mask[0] | mask[1] | mask[2] | mask[3]) != 0; }
GSYN_INLINE Float4 smaller(Float4 a, Float4 b) { return a < b ? a : b; }
GSYN_INLINE Float4 larger(Float4 a, Float4 b) { return a > b ? a : b; }
GSYN_INLINE Float4 root(Float4 a) {
    for (int i = 0; i < 4; i++) a[i] = sqrtf(a[i]);
    return a;
}
#endif

// ---- 8 lanes: AVX2
#if defined(__AVX2__)
typedef float Float8 __attribute__((vector_size(32)));
typedef int32_t Int8 __attribute__((vector_size(32)));

GSYN_INLINE Int8 less(Float8 a, Float8 b) { return a < b; }
GSYN_INLINE Int8 at_least(Float8 a, Float8 b) { return a >= b; }
GSYN_INLINE Int8 equal(Float8 a, Float8 b) { return a == b; }
GSYN_INLINE Int8 both(Int8 a, Int8 b) { return a & b; }
GSYN_INLINE Int8 without(Int8 a, Int8 b) { return a & ~b; }
GSYN_INLINE Float8 select(Int8 mask, Float8 a, Float8 b) { return mask ? a : b; }
GSYN_INLINE Float8 kept(Int8 mask, Float8 a) { return (Float8)(mask & (Int8)a); }
GSYN_INLINE Float8 negated(Int8 mask, Float8 a) { return (Float8)((Int8)a ^ (mask & INT32_MIN)); }
GSYN_INLINE bool any(Int8 mask) { return _mm256_movemask_ps((__m256)mask) != 0; }
GSYN_INLINE Float8 smaller(Float8 a, Float8 b) { return _mm256_min_ps(a, b); }
GSYN_INLINE Float8 larger(Float8 a, Float8 b) { return _mm256_max_ps(a, b); }
GSYN_INLINE Float8 root(Float8 a) { return _mm256_sqrt_ps(a); }
#endif

// ---- 16 lanes: AVX-512, comparisons give bit masks
#if defined(__AVX512F__)
typedef float Float16 __attribute__((vector_size(64)));
typedef __mmask16 Mask16;

GSYN_INLINE Mask16 less(Float16 a, Float16 b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
GSYN_INLINE Mask16 at_least(Float16 a, Float16 b) { return _mm512_cmp_ps_mask(a, b, _CMP_GE_OQ); }
GSYN_INLINE Mask16 equal(Float16 a, Float16 b) { return _mm512_cmp_ps_mask(a, b, _CMP_EQ_OQ); }
GSYN_INLINE Mask16 both(Mask16 a, Mask16 b) { return a & b; }
GSYN_INLINE Mask16 without(Mask16 a, Mask16 b) { return a & ~b; }
GSYN_INLINE Float16 select(Mask16 m, Float16 a, Float16 b) { return _mm512_mask_blend_ps(m, b, a); }
GSYN_INLINE Float16 kept(Mask16 mask, Float16 a) { return _mm512_maskz_mov_ps(mask, a); }
GSYN_INLINE Float16 negated(Mask16 m, Float16 a) {
    return _mm512_mask_sub_ps(a, m, _mm512_setzero_ps(), a);
}
GSYN_INLINE bool any(Mask16 mask) { return mask != 0; }
GSYN_INLINE Float16 smaller(Float16 a, Float16 b) { return _mm512_min_ps(a, b); }
GSYN_INLINE Float16 larger(Float16 a, Float16 b) { return _mm512_max_ps(a, b); }
GSYN_INLINE Float16 root(Float16 a) { return _mm512_sqrt_ps(a); }
#endif

// ---- The vector the kernels are written in
constexpr int LANES = GSYN_LANES;
#if GSYN_LANES == 16
using Floats = Float16;
using Mask = Mask16;
#elif GSYN_LANES == 8
using Floats = Float8;
using Mask = Int8;
#else
using Floats = Float4;
using Mask = Int4;
#endif

GSYN_INLINE Floats all(float value) { return Floats{} + value; }
GSYN_INLINE Floats clamp(Floats x, float low, float high) {
    return smaller(larger(x, all(low)), all(high));
}
GSYN_INLINE Floats load(const float *from) {
    Floats v;
    memcpy(&v, from, sizeof v);
    return v;
}
GSYN_INLINE void store(float *to, Floats v) { memcpy(to, &v, sizeof v); }

// 1/x to about 22 bits, for x from 0.01 to 1.
GSYN_INLINE Floats reciprocal(Floats x) {
#if GSYN_LANES == 16
    const Floats guess = _mm512_rcp14_ps(x);
#elif GSYN_LANES == 8
    const Floats guess = _mm256_rcp_ps(x);
#elif defined(__SSE2__)
    const Floats guess = _mm_rcp_ps(x);
#else
    return 1.f / x;
#endif
#if defined(__SSE2__)
    return guess + guess * (1.f - x * guess);
#endif
}

// The first and the second half of a vector, added.
#if GSYN_LANES == 16
GSYN_INLINE Float8 folded(Float16 v) {
    return __builtin_shufflevector(v, v, 0, 1, 2, 3, 4, 5, 6, 7) +
           __builtin_shufflevector(v, v, 8, 9, 10, 11, 12, 13, 14, 15);
}
#endif
#if GSYN_LANES >= 8
GSYN_INLINE Float4 folded(Float8 v) {
    return __builtin_shufflevector(v, v, 0, 1, 2, 3) + __builtin_shufflevector(v, v, 4, 5, 6, 7);
}
#endif

GSYN_INLINE float sum_of(Float4 v) { return (v[0] + v[2]) + (v[1] + v[3]); }
#if GSYN_LANES >= 8
GSYN_INLINE float sum_of(Float8 v) { return sum_of(folded(v)); }
#endif
#if GSYN_LANES == 16
GSYN_INLINE float sum_of(Float16 v) { return sum_of(folded(v)); }
#endif

// The sums over the lanes of four vectors of four, by transposing.
GSYN_INLINE Float4 four_sums(Float4 a, Float4 b, Float4 c, Float4 d) {
    const Float4 ab = __builtin_shufflevector(a, b, 0, 1, 4, 5) + __builtin_shufflevector(a, b, 2, 3, 6, 7);
    const Float4 cd = __builtin_shufflevector(c, d, 0, 1, 4, 5) + __builtin_shufflevector(c, d, 2, 3, 6, 7);
    return __builtin_shufflevector(ab, cd, 0, 2, 4, 6) + __builtin_shufflevector(ab, cd, 1, 3, 5, 7);
}

#if GSYN_LANES >= 8
// Lanes 0 to 3 get the sum of halves of a, lanes 4 to 7 that of b.
GSYN_INLINE Float8 both_folded(Float8 a, Float8 b) {
    return __builtin_shufflevector(a, b, 0, 1, 2, 3, 8, 9, 10, 11) +
           __builtin_shufflevector(a, b, 4, 5, 6, 7, 12, 13, 14, 15);
}
GSYN_INLINE Float8 eight_sums(const Float8 *v) {
    const Float8 a = both_folded(v[0], v[4]), b = both_folded(v[1], v[5]);
    const Float8 c = both_folded(v[2], v[6]), d = both_folded(v[3], v[7]);
    const Float8 ab = __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13) +
                      __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15);
    const Float8 cd = __builtin_shufflevector(c, d, 0, 1, 8, 9, 4, 5, 12, 13) +
                      __builtin_shufflevector(c, d, 2, 3, 10, 11, 6, 7, 14, 15);
    return __builtin_shufflevector(ab, cd, 0, 2, 8, 10, 4, 6, 12, 14) +
           __builtin_shufflevector(ab, cd, 1, 3, 9, 11, 5, 7, 13, 15);
}
#endif

// Writes the sums over the lanes of each of eight vectors.
GSYN_INLINE void store_sums(float *sums, const Floats *v) {
#if GSYN_LANES == 16
    Float8 halves[8];
    for (int k = 0; k < 8; k++) halves[k] = folded(v[k]);
    const Float8 total = eight_sums(halves);
    memcpy(sums, &total, sizeof total);
#elif GSYN_LANES == 8
    const Float8 total = eight_sums(v);
    memcpy(sums, &total, sizeof total);
#else
    const Float4 first = four_sums(v[0], v[1], v[2], v[3]), last = four_sums(v[4], v[5], v[6], v[7]);
    memcpy(sums, &first, sizeof first);
    memcpy(sums + 4, &last, sizeof last);
#endif
}

// Neither infinite nor NaN.
GSYN_INLINE Mask finite(Floats v) { return equal(v - v, Floats{}); }

// 2^x on [-8, 0] with a relative error of at most 3e-6.
GSYN_INLINE Floats exp2_small(Floats x) {
#if GSYN_LANES == 16
    const Floats whole = _mm512_roundscale_ps(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
    const Floats rest = x - whole;
    Floats p = rest * 9.570101910e-3f + 5.591786032e-2f;
    p = p * rest + 2.402474483e-1f;
    p = p * rest + 6.931218147e-1f;
    p = p * rest + 9.999992614e-1f;
    return _mm512_scalef_ps(p, whole);
#else
    // Without an instruction that scales: a polynomial of 2^(x/8), three times squared.
    Floats p = x * 2.864954643e-8f + 2.243313411e-6f;
    p = p * x + 1.079682082e-4f;
    p = p * x + 3.752690457e-3f;
    p = p * x + 8.664278157e-2f;
    p = p * x + 9.999999251e-1f;
    p = p * p;
    p = p * p;
    return p * p;
#endif
}

typedef int32_t Ints __attribute__((vector_size(4 * GSYN_LANES)));

// e^x to about 2e-7 (Cephes' polynomial); NaN stays NaN.
GSYN_INLINE Floats exp_of(Floats x) {
    x = select(less(x, all(-87.f)), all(-87.f), x);
    x = select(less(all(88.f), x), all(88.f), x);
    const float round = 12582912.f;  // 1.5 · 2^23: adding it leaves an integer
    const Floats n = (x * 1.44269504f + round) - round;
    const Floats r = x - n * 0.693359375f + n * 2.12194440e-4f;
    Floats p = r * 1.9875691500e-4f + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    p = p * r * r + r + 1.f;
    const Ints bits = (__builtin_convertvector(n, Ints) + 127) << 23;
    return p * (Floats)bits;
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
