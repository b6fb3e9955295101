// The two hot loops of decoding, WebAssembly SIMD. src/decode/kernel/js.ts has the same arithmetic in the same
// order, so that both agree bit for bit: no fused multiply-add, no reordering.
#include <stdint.h>
#include <wasm_simd128.h>

#define EXPORT(name) __attribute__((export_name(#name)))
typedef uint32_t u32;
/// Unrolled although the build is for size: an array of sums has to stay in registers.
#define UNROLL _Pragma("clang loop unroll(full)")

/// Trilinear features of one hash grid at n points u [n, 3]; row i goes to out + i * stride.
EXPORT(gather) void gather(const float *u, u32 n, const float *table, u32 size, u32 resolution,
                           u32 features, float *out, u32 stride) {
  const float span = (float)(resolution - 1);
  const u32 last = resolution - 1, base = resolution >= 2 ? resolution - 2 : 0;
  const int dense = (uint64_t)resolution * resolution * resolution <= size;
  const u32 mask = size & (size - 1) ? 0 : size - 1;  // A division costs more than all the rest.
  for (u32 i = 0; i < n; i++, u += 3, out += stride) {
    float part[3];
    u32 low[3], high[3];
    for (int a = 0; a < 3; a++) {
      const float p = u[a] * span;
      u32 cell = (u32)p;
      if (cell > base) cell = base;
      part[a] = p - (float)cell;
      low[a] = cell;
      high[a] = cell + 1 > last ? last : cell + 1;
    }
    for (u32 f = 0; f < features; f++) out[f] = 0;
    for (int c = 0; c < 8; c++) {
      const u32 x = c & 1 ? high[0] : low[0], y = c & 2 ? high[1] : low[1];
      const u32 z = c & 4 ? high[2] : low[2];
      const float wx = c & 1 ? part[0] : 1 - part[0], wy = c & 2 ? part[1] : 1 - part[1];
      const float w = wx * wy * (c & 4 ? part[2] : 1 - part[2]);
      u32 row = x + resolution * (y + resolution * z);
      if (!dense) {
        row = x ^ (y * 2654435761u) ^ (z * 805459861u);
        row = mask ? row & mask : row % size;
      }
      const float *value = table + row * features;
      if (features == 4) {
        const v128_t sum = wasm_v128_load(out), v = wasm_v128_load(value);
        wasm_v128_store(out, wasm_f32x4_add(sum, wasm_f32x4_mul(v, wasm_f32x4_splat(w))));
      } else {
        for (u32 f = 0; f < features; f++) out[f] += value[f] * w;
      }
    }
  }
}

/// Codebook rows by code: out[i, 0..width) = book[codes[i]].
EXPORT(look_up) void look_up(const uint8_t *codes, u32 n, const float *book, u32 width, float *out,
                             u32 stride) {
  for (u32 i = 0; i < n; i++, out += stride) {
    const float *row = book + codes[i] * width;
    for (u32 d = 0; d < width; d++) out[d] = row[d];
  }
}

/// out [n, outs] = relu?(start + x [n, ins] · weights [ins, outs]); start is one row, or [n, outs]
/// where `rows` is set. outs is a multiple of 4; sums run over inputs in their order.
EXPORT(dense) void dense(const float *x, u32 n, u32 ins, u32 stride, const float *weights,
                         const float *start, u32 rows, u32 outs, u32 relu, float *out) {
  const v128_t zero = wasm_f32x4_splat(0);
  for (u32 i = 0; i < n; i++) {
    const float *row = x + i * stride;
    const float *begin = rows ? start + i * outs : start;
    float *to = out + i * outs;
    u32 o = 0;
    for (; o + 32 <= outs; o += 32) {
      v128_t s[8];
      UNROLL for (int k = 0; k < 8; k++) s[k] = wasm_v128_load(begin + o + 4 * k);
      const float *w = weights + o;
      for (u32 j = 0; j < ins; j++, w += outs) {
        const v128_t v = wasm_v128_load32_splat(row + j);
        UNROLL for (int k = 0; k < 8; k++)
          s[k] = wasm_f32x4_add(s[k], wasm_f32x4_mul(wasm_v128_load(w + 4 * k), v));
      }
      UNROLL for (int k = 0; k < 8; k++)
        wasm_v128_store(to + o + 4 * k, relu ? wasm_f32x4_pmax(zero, s[k]) : s[k]);
    }
    for (; o < outs; o += 4) {
      v128_t s = wasm_v128_load(begin + o);
      const float *w = weights + o;
      for (u32 j = 0; j < ins; j++, w += outs)
        s = wasm_f32x4_add(s, wasm_f32x4_mul(wasm_v128_load(w), wasm_v128_load32_splat(row + j)));
      wasm_v128_store(to + o, relu ? wasm_f32x4_pmax(zero, s) : s);
    }
  }
}

/// Sum over `width` (a multiple of 4) in four lanes, then the lanes pairwise, then the bias.
static inline float dot(const float *a, const float *b, u32 width, float bias) {
  v128_t s = wasm_f32x4_splat(0);
  for (u32 j = 0; j < width; j += 4)
    s = wasm_f32x4_add(s, wasm_f32x4_mul(wasm_v128_load(a + j), wasm_v128_load(b + j)));
  const float even = wasm_f32x4_extract_lane(s, 0) + wasm_f32x4_extract_lane(s, 2);
  const float odd = wasm_f32x4_extract_lane(s, 1) + wasm_f32x4_extract_lane(s, 3);
  return even + odd + bias;
}

/// e^x to about 2 units in the last place, for |x| < 87.
static inline float exponential(float x) {
  if (x > 87.0f) x = 87.0f;
  if (x < -87.0f) x = -87.0f;
  const float n = __builtin_floorf(x * 1.44269504f + 0.5f);
  const float r = x - n * 0.693359375f - n * -2.12194440e-4f;
  float p = 1.9875691500e-4f;
  p = p * r + 1.3981999507e-3f;
  p = p * r + 8.3334519073e-3f;
  p = p * r + 4.1665795894e-2f;
  p = p * r + 1.6666665459e-1f;
  p = p * r + 5.0000001201e-1f;
  p = p * (r * r) + r + 1.0f;
  union { u32 bits; float value; } power = {(u32)((int)n + 127) << 23};
  return p * power.value;
}

static inline float sigmoid(float x) { return 1.0f / (1.0f + exponential(-x)); }

/// The heads' second layers for the slots listed. Of each: opacity, 3 scale factors, quaternion
/// w x y z, RGB; only the opacity where it is below `least`.
/// hidden [n, 3 * width]: opacity, cov, color; weights [outputs * slots, width] each.
EXPORT(heads) void heads(const float *hidden, u32 width, const u32 *owners, const uint8_t *slots,
                         u32 count, const float *const *nets, float least, float *out) {
  const float *ow = nets[0], *ob = nets[1], *vw = nets[2], *vb = nets[3], *cw = nets[4],
              *cb = nets[5];
  for (u32 i = 0; i < count; i++, out += 11) {
    const float *h = hidden + owners[i] * 3 * width;
    const u32 slot = slots[i];
    // tanh
    out[0] = 1.0f - 2.0f / (exponential(2.0f * dot(h, ow + slot * width, width, ob[slot])) + 1.0f);
    if (!(out[0] >= least)) continue;
    float q[4], norm = 0;
    for (u32 k = 0; k < 7; k++) {
      const u32 row = slot * 7 + k;
      const float v = dot(h + width, vw + row * width, width, vb[row]);
      if (k < 3) out[1 + k] = sigmoid(v);
      else q[k - 3] = v, norm += v * v;
    }
    norm = __builtin_sqrtf(norm);
    if (norm < 1e-12f) norm = 1e-12f;
    for (u32 k = 0; k < 4; k++) out[4 + k] = q[k] / norm;
    for (u32 k = 0; k < 3; k++) {
      const u32 row = slot * 3 + k;
      out[8 + k] = sigmoid(dot(h + 2 * width, cw + row * width, width, cb[row]));
    }
  }
}
