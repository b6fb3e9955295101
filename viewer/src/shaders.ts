/** The two shaders. Constants as in docs/conventions.md: those of our rasterisers. */

/** Quads per instance; software rasterisers pay for every instance. */
export const QUADS = 128;
/** Texels per row of each texture. */
export const ROW = 2048;

export const VERTEX = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform highp sampler2D centers;
uniform usampler2D words;
uniform usampler2D order;
uniform int count;
uniform mat3 turn;
uniform vec3 shift;
uniform vec2 focal;
uniform vec2 middle;
uniform vec2 size;
uniform float near;
uniform float time;
uniform float fade;
out vec2 place;
flat out vec4 color;

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  int number = gl_InstanceID * ${QUADS} + (gl_VertexID >> 2);
  if (number >= count) return;
  int splat = int(texelFetch(order, ivec2(number % ${ROW}, number / ${ROW}), 0).x);
  vec4 center = texelFetch(centers, ivec2(splat % ${ROW}, splat / ${ROW}), 0);
  vec3 p = turn * center.xyz + shift;
  if (p.z < near) return;
  int first = (splat % ${ROW / 2}) * 2;
  uvec4 one = texelFetch(words, ivec2(first, splat / ${ROW / 2}), 0);
  uvec4 two = texelFetch(words, ivec2(first + 1, splat / ${ROW / 2}), 0);
  vec2 rg = unpackHalf2x16(two.z);
  vec2 ba = unpackHalf2x16(two.w);
  float opacity = ba.y * clamp((time - center.w) / fade, 0.0, 1.0);
  if (opacity < 1.0 / 255.0) return;
  float xx = uintBitsToFloat(one.x), xy = uintBitsToFloat(one.y), xz = uintBitsToFloat(one.z);
  float yy = uintBitsToFloat(one.w), yz = uintBitsToFloat(two.x), zz = uintBitsToFloat(two.y);
  mat3 covariance = turn * mat3(xx, xy, xz, xy, yy, yz, xz, yz, zz) * transpose(turn);
  vec2 ratio = p.xy / p.z;
  vec2 most = 1.3 * 0.5 * size / focal;
  vec2 held = clamp(ratio, -most, most);
  vec3 jx = vec3(focal.x, 0.0, -focal.x * held.x) / p.z;
  vec3 jy = vec3(0.0, focal.y, -focal.y * held.y) / p.z;
  vec3 cx = covariance * jx, cy = covariance * jy;
  float a = dot(jx, cx) + 0.3, b = dot(jx, cy), c = dot(jy, cy) + 0.3;
  float mean = 0.5 * (a + c);
  float spread = length(vec2(0.5 * (a - c), b));
  float large = mean + spread, small = max(mean - spread, 1e-9);
  // The longer of two ways to write the first axis, so that neither cancels out.
  vec2 axis = a >= c ? vec2(0.5 * (a - c) + spread, b) : vec2(b, 0.5 * (c - a) + spread);
  axis = dot(axis, axis) > 0.0 ? normalize(axis) : vec2(1.0, 0.0);
  float cut = sqrt(2.0 * log(255.0 * opacity));
  vec2 corner = vec2(float(gl_VertexID & 1), float((gl_VertexID >> 1) & 1)) * 2.0 - 1.0;
  place = corner * cut;
  vec2 pixel = focal * ratio + middle
    + place.x * sqrt(large) * axis + place.y * sqrt(small) * vec2(-axis.y, axis.x);
  color = vec4(rg, ba.x, opacity);
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
}`;

export const FRAGMENT = `#version 300 es
precision highp float;
in vec2 place;
flat in vec4 color;
out vec4 result;

void main() {
  float alpha = min(0.99, color.a * exp(-0.5 * dot(place, place)));
  if (alpha < 1.0 / 255.0) discard;
  result = vec4(color.rgb * alpha, alpha);
}`;
