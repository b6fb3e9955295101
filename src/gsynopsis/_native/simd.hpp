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

// Neither infinite nor NaN.
GSYN_INLINE Mask finite(Floats v) { return equal(v - v, Floats{}); }

// e^x on [-5.6, 0], relative error 6e-7 before rounding: a polynomial of e^(x/8), three times squared.
GSYN_INLINE Floats exp_small(Floats x) {
    Floats p = x * 1.78428749e-7f + 9.71009467e-6f;
    p = p * x + 3.24167893e-4f;
    p = p * x + 7.81066529e-3f;
    p = p * x + 1.24999069e-1f;
    p = p * x + 9.99999940e-1f;
    p = p * p;
    p = p * p;
    return p * p;
}

}  // namespace GSYN_VARIANT
}  // namespace gsyn
