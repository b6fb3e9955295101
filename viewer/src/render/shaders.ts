/** The shaders. Constants as in docs/conventions.md: those of our rasterisers. */

/** Splats per instance; software rasterisers pay for every instance. */
export const BATCH = 128;
/** Least depth at which a splat is drawn, world units. */
export const NEAR = 0.01;
/** Texels per row of each texture. */
export const ROW = 2048;

/** Two looks of a splat, mixed: `share` of the second; a splat that one of them does not draw keeps its form. */
const MIX = `
void mixed(uvec4 one0, uvec4 two0, float share, inout uvec4 one, inout uvec4 two) {
  float was = unpackHalf2x16(two0.w).y, now = unpackHalf2x16(two.w).y;
  uvec4 one1 = now > 0.0 ? one : one0, two1 = now > 0.0 ? two : two0;
  if (was == 0.0) { one0 = one1; two0 = two1; }
  one = floatBitsToUint(mix(uintBitsToFloat(one0), uintBitsToFloat(one1), share));
  two.xy = floatBitsToUint(mix(uintBitsToFloat(two0.xy), uintBitsToFloat(two1.xy), share));
  two.z = packHalf2x16(mix(unpackHalf2x16(two0.z), unpackHalf2x16(two1.z), share));
  float blue = mix(unpackHalf2x16(two0.w).x, unpackHalf2x16(two1.w).x, share);
  two.w = packHalf2x16(vec2(blue, mix(was, now, share)));
}
// Attributes of a splat at some time, nothing drawn from limit on.
void look(int splat, out uvec4 one, out uvec4 two) {
  ivec2 texel = ivec2((splat % ${ROW / 2}) * 2, splat / ${ROW / 2});
  one = texelFetch(words, texel, 0);
  two = texelFetch(words, texel + ivec2(1, 0), 0);
  if (splat >= limit) two.w &= 0xffffu;
  if (!changing) return;
  float share = clamp((time - texelFetch(times, ivec2(0, texel.y), 0).x) / fade, 0.0, 1.0);
  if (share == 1.0) return;
  mixed(texelFetch(before, texel, 0), texelFetch(before, texel + ivec2(1, 0), 0), share, one, two);
}`;

const LOOK = `
uniform usampler2D words;
uniform usampler2D before;
uniform highp sampler2D times;
uniform int limit;
uniform bool changing;
uniform float time;
uniform float fade;${MIX}`;

/** `LOOK` while nothing changes: some devices do both sides of a branch, and pay for what a change would read. */
const STILL_LOOK = `
uniform usampler2D words;
uniform int limit;
void look(int splat, out uvec4 one, out uvec4 two) {
  ivec2 texel = ivec2((splat % ${ROW / 2}) * 2, splat / ${ROW / 2});
  one = texelFetch(words, texel, 0);
  two = texelFetch(words, texel + ivec2(1, 0), 0);
  if (splat >= limit) two.w &= 0xffffu;
}`;

/** Uniforms of `LOOK`. */
export const LOOK_NAMES = ["words", "before", "times", "limit", "changing", "time", "fade"] as const;

/** 2 ln 2: devices compute exponents of 2. */
const UNIT = 1.3862944;

/** The picture of a splat: for vertex shaders, ours and those of other engines. */
export const PROJECT = `
uniform vec2 focal;
uniform vec2 middle;
uniform vec2 size;
uniform vec2 dilations; // a splat's own, and all
out vec2 place;
flat out vec4 color;
// The pixel of a splat's corner, p in the camera's axes; false where none is drawn.
bool project(vec3 p, mat3 turn, uvec4 one, uvec4 two, vec2 corner, out vec2 pixel) {
  vec2 rg = unpackHalf2x16(two.z);
  vec2 ba = unpackHalf2x16(two.w);
  float opacity = ba.y;
  if (opacity < 1.0 / 255.0) return false;
  float xx = uintBitsToFloat(one.x), xy = uintBitsToFloat(one.y), xz = uintBitsToFloat(one.z);
  float yy = uintBitsToFloat(one.w), yz = uintBitsToFloat(two.x), zz = uintBitsToFloat(two.y);
  mat3 covariance = mat3(xx, xy, xz, xy, yy, yz, xz, yz, zz);
  vec2 ratio = p.xy / p.z;
  vec2 most = 1.3 * 0.5 * size / focal;
  vec2 held = clamp(ratio, -most, most);
  // Rows of the Jacobian in the world's axes: to turn them takes less than to turn the covariance.
  vec3 jx = vec3(focal.x, 0.0, -focal.x * held.x) / p.z * turn;
  vec3 jy = vec3(0.0, focal.y, -focal.y * held.y) / p.z * turn;
  vec3 cx = covariance * jx, cy = covariance * jy;
  float a = dot(jx, cx), b = dot(jx, cy), c = dot(jy, cy);
  vec2 own = vec2(a, c) + dilations.x;
  a += dilations.y;
  c += dilations.y;
  if (dilations.x < dilations.y) opacity *= sqrt(clamp((own.x * own.y - b * b) / (a * c - b * b), 0.0, 1.0));
  if (opacity < 1.0 / 255.0) return false;
  // A square root of the covariance, from its larger side, in units in which a Gaussian is 2^-r².
  float wide = sqrt(${UNIT} * max(a, c)), skew = ${UNIT} * b / wide, thin = sqrt(max(${UNIT} * min(a, c) - skew * skew, 1e-9));
  place = corner * sqrt(log2(255.0 * opacity));
  pixel = focal * ratio + middle
    + (a >= c ? vec2(wide * place.x, skew * place.x + thin * place.y) : vec2(skew * place.x - thin * place.y, wide * place.x));
  color = vec4(rg, ba.x, opacity);
  return true;
}`;

/**
 * The vertex shader, whose numbers are highp unless it says otherwise; `changing`: while looks turn into others. A splat is an equilateral triangle around
 * the circle of radius 1, where its ellipse ends.
 */
export const vertexShader = (changing: boolean) => `#version 300 es
precision highp usampler2D;
uniform highp sampler2D centers;
uniform usampler2D order;
uniform int count;
uniform mat4x3 w2c;
${changing ? LOOK : STILL_LOOK}${PROJECT}

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  int number = gl_InstanceID * ${BATCH} + gl_VertexID / 3;
  if (number >= count) return;
  int splat = int(texelFetch(order, ivec2(number % ${ROW}, number / ${ROW}), 0).x);
  vec3 p = w2c * vec4(texelFetch(centers, ivec2(splat % ${ROW}, splat / ${ROW}), 0).xyz, 1.0);
  if (p.z < ${NEAR}) return;
  uvec4 one, two;
  look(splat, one, two);
  int side = gl_VertexID % 3;
  vec2 corner = side == 0 ? vec2(0.0, 2.0) : vec2(side == 1 ? -1.7320509 : 1.7320509, -1.0);
  vec2 pixel;
  if (project(p, mat3(w2c), one, two, corner, pixel)) gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
}`;

/** Coverage of a pixel by a splat, for fragment shaders. */
export const ALPHA = `
in vec2 place;
flat in vec4 color;
float alphaAt() {
  float alpha = min(0.99, color.a * exp2(-dot(place, place)));
  if (alpha < 1.0 / 255.0) discard;
  return alpha;
}`;

export const FRAGMENT = `#version 300 es
precision highp float;
out vec4 result;${ALPHA}

void main() {
  float alpha = alphaAt();
  result = vec4(color.rgb * alpha, alpha);
}`;

/** One triangle over all of the target. */
export const COVER = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

/** The attributes of this moment, texel by texel as in `words` from a row on. */
export const BAKE = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
out uvec4 result;
uniform int row;
${LOOK}

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  uvec4 one, two;
  look((row + pixel.y) * ${ROW / 2} + (pixel.x >> 1), one, two);
  result = (pixel.x & 1) == 0 ? one : two;
}`;
