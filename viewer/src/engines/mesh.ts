/** Splats as a mesh of another engine's scene: its camera as ours, and the shaders of that mesh. */

import { cross, dot } from "../base/vec3";
import type { Pinhole } from "../camera/camera";
import { lensOf } from "../camera/projection";
import type { Vec } from "../base/vec3";
import type { ViewPose } from "../base/view-pose";
import { ALPHA, BATCH, NEAR, PROJECT, ROW } from "../render/shaders";

/**
 * A camera of OpenGL axes (y up, looking along -z) as a pinhole camera of ours.
 *
 * `view` takes what `w2c` shall take to the camera's axes, `projection` those to clip space; both have 16
 * numbers, column after column. The picture has so many pixels. `width` and `height` count pixels.
 */
export function pinholeOf(view: ArrayLike<number>, projection: ArrayLike<number>, width: number, height: number): Pinhole {
  const row = (i: number, sign: number) => [0, 4, 8, 12].map((column) => sign * view[column + i]);
  return { ...lensOf(projection, width, height), w2c: [...row(0, 1), ...row(1, -1), ...row(2, -1)] };
}

/** Pose of a camera in the file's own coordinates, whatever turns, shifts and scales these. */
export function viewPoseThrough({ w2c, width, height, fx, fy }: Pinhole): ViewPose {
  const [x, y, z] = [0, 4, 8].map((at) => w2c.slice(at, at + 3) as Vec);
  const [yz, zx, xy] = [cross(y, z), cross(z, x), cross(x, y)];
  const volume = dot(x, yz);
  // A picture does not depend on the unit of length: to the decoder it is that of the file.
  const unit = Math.cbrt(volume);
  const position = [0, 1, 2].map((i) => -(yz[i] * w2c[3] + zx[i] * w2c[7] + xy[i] * w2c[11]) / volume) as Vec;
  return { w2c: w2c.map((value) => value / unit), position, right: width / (2 * fx), up: height / (2 * fy) };
}

/** Corners of `BATCH` quads, two triangles each: the index of the mesh, which has no vertices of its own. */
export function quadIndex(): Uint16Array<ArrayBuffer> {
  return Uint16Array.from({ length: 6 * BATCH }, (_, i) => 4 * Math.floor(i / 6) + [0, 1, 2, 2, 1, 3][i % 6]);
}

/** Instances of the mesh for so many splats. */
export function instancesOf(count: number): number {
  return Math.ceil(count / BATCH);
}

/** Rows of `w2c` as the uniforms `turn` (by columns) and `shift`. */
export function poseUniforms({ w2c }: Pinhole): { turn: number[]; shift: number[] } {
  const [a, b, c, x, d, e, f, y, g, h, i, z] = w2c;
  return { turn: [a, d, g, b, e, h, c, f, i], shift: [x, y, z] };
}

/**
 * A vertex shader without its `#version`: splats at the depth of their centres.
 *
 * Uniforms: the tables `centers`, `words` and `order`; `count` and `limit` of them; `turn`, `shift`, `focal`,
 * `middle`, `size` and `dilations` as in `Renderer`; and the engine's `projection`.
 */
export const MESH_VERTEX = `
precision highp float;
precision highp int;
precision highp usampler2D;
uniform highp sampler2D centers;
uniform usampler2D words;
uniform usampler2D order;
uniform int count;
uniform int limit;
uniform mat3 turn;
uniform vec3 shift;
uniform mat4 projection;${PROJECT}

void main() {
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  int number = gl_InstanceID * ${BATCH} + (gl_VertexID >> 2);
  if (number >= count) return;
  int splat = int(texelFetch(order, ivec2(number % ${ROW}, number / ${ROW}), 0).x);
  if (splat >= limit) return;
  vec3 p = turn * texelFetch(centers, ivec2(splat % ${ROW}, splat / ${ROW}), 0).xyz + shift;
  if (p.z < ${NEAR}) return;
  ivec2 texel = ivec2((splat % ${ROW / 2}) * 2, splat / ${ROW / 2});
  vec2 corner = vec2(float(gl_VertexID & 1), float((gl_VertexID >> 1) & 1)) * 2.0 - 1.0;
  vec2 pixel;
  if (!project(p, turn, texelFetch(words, texel, 0), texelFetch(words, texel + ivec2(1, 0), 0), corner, pixel)) return;
  vec4 clip = projection * vec4(p.x, -p.yz, 1.0);
  vec2 at = 2.0 * pixel / size - 1.0;
  gl_Position = vec4(at.x * clip.w, -at.y * clip.w, clip.z, clip.w);
}`;

/** A fragment shader without its `#version` and `main`: `splat()` is the colour times alpha, and alpha. */
export const MESH_FRAGMENT = `
precision highp float;
// What is drawn into holds linear light, not sRGB values.
uniform bool linear;${ALPHA}
vec4 splat() {
  float alpha = alphaAt();
  vec3 rgb = color.rgb;
  if (linear) rgb = mix(pow((rgb + 0.055) / 1.055, vec3(2.4)), rgb / 12.92, lessThanEqual(rgb, vec3(0.04045)));
  return vec4(rgb * alpha, alpha);
}`;
