/** The places of a scene's splats, read back from the graphics device: for looks, limits and walks. */

import { add, dot, unit } from "../base/vec3";
import type { Vec } from "../base/vec3";
import type { AnyRenderer } from "./backend";
import type { Renderer } from "./renderer";
import { COVER, ROW } from "./shaders";
import { Program } from "./textures";

/** Rows of splats that are read at once: 4 MiB. */
const ROWS = 128;
/** Numbers of a splat: centre, standard deviations along the scene's way up and across it, opacity. */
const NUMBERS = 6;
/** Splats that hide less are left out. */
const OPACITY_MIN = 0.1;
/** Splats of which a middle is taken, at most. */
const SAMPLES = 40_000;
/** Share of the splats that are dense ones: those nearest to their middle. */
const DENSE = 0.7;
/** Share of the light that has to be held back for something to be there. */
const THERE = 0.3;
/** Share of a way that has to be free. */
const FREE = 0.97;
/** Deviations before a place within which a splat is part of what the place lies on. */
const LYING = 4;

const COPY = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler2D;
uniform highp sampler2D centers;
uniform usampler2D words;
uniform int first;
uniform int limit;
uniform vec3 up;
out uvec4 result;
void main() {
  ivec2 place = ivec2(gl_FragCoord.xy) + ivec2(0, first);
  int splat = place.y * ${ROW} + place.x;
  ivec2 texel = ivec2((splat % ${ROW / 2}) * 2, splat / ${ROW / 2});
  uvec4 one = texelFetch(words, texel, 0), two = texelFetch(words, texel + ivec2(1, 0), 0);
  float opacity = splat < limit ? unpackHalf2x16(two.w).y : 0.0;
  vec3 sides = uintBitsToFloat(uvec3(one.xw, two.y)), mixed = uintBitsToFloat(uvec3(one.yz, two.x));
  float high = dot(up * up, sides) + 2.0 * dot(up.xxy * up.yzz, mixed);
  // Of a flat one, the radius of its disc; high: how thick a floor is.
  float wide = sqrt(0.5 * dot(sides, vec3(1.0)));
  float share = clamp(sqrt(max(high, 0.0)) / wide, 0.0, 1.0);
  uint thin = uint(255.0 * share + 0.5) << 8 | uint(255.0 * opacity + 0.5);
  result = uvec4(floatBitsToUint(texelFetch(centers, place, 0).xyz), packHalf2x16(vec2(wide, 0.0)) | thin << 16);
}`;

/** A ball, world units. */
export interface Ball {
  readonly center: Vec;
  readonly radius: number;
}

export class Survey {
  private constructor(
    /** Centre, deviations and opacity of each splat that hides something: world units [n, 6]. */
    private readonly splats: Float32Array,
    private readonly up: Vec,
  ) {}

  /** The survey of all that a renderer draws; `up`: the scene's way up, unit length. */
  static of(renderer: AnyRenderer, up: Vec): Survey {
    return new Survey("solids" in renderer ? renderer.solids(up, OPACITY_MIN) : read(renderer, up), up);
  }

  get count(): number {
    return this.splats.length / NUMBERS;
  }

  /** The part of it around a place. */
  around(place: Vec, radius: number): Survey {
    const { splats } = this;
    const near: number[] = [];
    for (let i = 0; i < splats.length; i += NUMBERS) {
      const far = radius + 3 * splats[i + 4];
      const away = (splats[i] - place[0]) ** 2 + (splats[i + 1] - place[1]) ** 2 + (splats[i + 2] - place[2]) ** 2;
      if (away < far * far) for (let k = 0; k < NUMBERS; k++) near.push(splats[i + k]);
    }
    return new Survey(new Float32Array(near), this.up);
  }

  /**
   * Depth along a ray at which half of what is on it is hidden; null where hardly anything is.
   *
   * `direction` has unit length; `spread` is the least deviation of a splat at a depth of 1, so that a ray is a cone.
   */
  depth(from: Vec, direction: Vec, spread: number): number | null {
    const met = this.meet(from, direction, spread, Infinity);
    met.sort((a, b) => a[0] - b[0]);
    const clear = met.reduce((rest, [, alpha]) => rest * (1 - alpha), 1);
    if (1 - clear < THERE) return null;
    const half = (1 + clear) / 2;
    let rest = 1;
    for (const [t, alpha] of met) {
      rest *= 1 - alpha;
      if (rest <= half) return t;
    }
    return null;
  }

  /** Share of the light from one place to another that is not held back on the way. */
  clear(from: Vec, to: Vec): number {
    const away = add(to, from, -1);
    const far = Math.sqrt(dot(away, away));
    return this.meet(from, unit(away), 0, FREE * far).reduce((rest, [, alpha]) => rest * (1 - alpha), 1);
  }

  /** Depths of the splats on a ray, whole before `end`, and how much of the light each of them holds back. */
  private meet(from: Vec, direction: Vec, spread: number, end: number): [depth: number, alpha: number][] {
    const { splats, up } = this;
    const [dx, dy, dz] = direction;
    const [ux, uy, uz] = up;
    const climb = dot(direction, up);
    const met: [depth: number, alpha: number][] = [];
    for (let i = 0; i < splats.length; i += NUMBERS) {
      const x = splats[i] - from[0];
      const y = splats[i + 1] - from[1];
      const z = splats[i + 2] - from[2];
      const t = x * dx + y * dy + z * dz;
      if (t <= 0) continue;
      const far = x * x + y * y + z * z;
      const wide = Math.max(splats[i + 4], spread * t);
      if (far - t * t > 9 * wide * wide) continue;
      // Where the way up is stretched until the splat is a ball.
      const high = Math.max(splats[i + 3], spread * t);
      const stretch = (wide * wide) / (high * high) - 1;
      const rise = x * ux + y * uy + z * uz;
      const along = t + stretch * rise * climb;
      const length = 1 + stretch * climb * climb;
      const depth = along / length;
      const power = (far + stretch * rise * rise - along * depth) / (wide * wide);
      // What a place lies on is not before it.
      if (power < 9 && depth > 0 && depth + LYING * Math.min(wide, high) < end) met.push([depth, Math.min(0.99, splats[i + 5] * Math.exp(-0.5 * power))]);
    }
    return met;
  }

  /** The ball of the dense part: around the median of the splats, the nearest of them. */
  dense(): Ball | null {
    const { splats, count } = this;
    if (!count) return null;
    const step = NUMBERS * Math.max(1, Math.floor(count / SAMPLES));
    const places: Vec[] = [];
    for (let i = 0; i < splats.length; i += step) places.push([splats[i], splats[i + 1], splats[i + 2]]);
    const center = [0, 1, 2].map((axis) => middle(places.map((place) => place[axis]), 0.5)) as Vec;
    const far = places.map((place) => {
      const away = place.map((value, axis) => value - center[axis]) as Vec;
      return Math.sqrt(dot(away, away));
    });
    return { center, radius: middle(far, DENSE) };
  }
}

/** The number below which so much of a list lies. */
function middle(values: number[], share: number): number {
  values.sort((a, b) => a - b);
  return values[Math.min(values.length - 1, Math.floor(share * values.length))];
}

function read(renderer: Renderer, up: Vec): Float32Array {
  const { gl, centers } = renderer;
  if (!centers || gl.isContextLost()) return new Float32Array(0);
  const { words, limit } = renderer.layer(0);
  const program = new Program(gl, COVER, COPY, ["centers", "words", "first", "limit", "up"]);
  const rows = Math.ceil(limit / ROW);
  const [frame, buffer] = [gl.createFramebuffer(), gl.createRenderbuffer()];
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
  gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA32UI, ROW, ROWS);
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, buffer);
  gl.viewport(0, 0, ROW, ROWS);
  gl.disable(gl.BLEND);
  program.use();
  program.bind("centers", 0, centers);
  program.bind("words", 1, words);
  gl.uniform1i(program.at("limit"), limit);
  gl.uniform3f(program.at("up"), ...up);
  const pixels = new Uint32Array(4 * ROW * ROWS);
  const floats = new Float32Array(pixels.buffer);
  const parts: Float32Array[] = [];
  for (let first = 0; first < rows; first += ROWS) {
    gl.uniform1i(program.at("first"), first);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.readPixels(0, 0, ROW, ROWS, gl.RGBA_INTEGER, gl.UNSIGNED_INT, pixels);
    parts.push(hiding(pixels, floats));
  }
  gl.enable(gl.BLEND);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.deleteFramebuffer(frame);
  gl.deleteRenderbuffer(buffer);
  program.close();
  const all = new Float32Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}

/** The splats that hide something, of those that the shader copied. */
function hiding(pixels: Uint32Array, floats: Float32Array): Float32Array {
  const found = new Float32Array((NUMBERS * pixels.length) / 4);
  let to = 0;
  for (let at = 0; at < pixels.length; at += 4) {
    const bits = pixels[at + 3];
    const opacity = ((bits >>> 16) & 255) / 255;
    if (opacity < OPACITY_MIN) continue;
    for (let axis = 0; axis < 3; axis++) found[to++] = floats[at + axis];
    const wide = ofHalf(bits & 0xffff);
    // At least a step of its byte.
    found[to++] = (wide * Math.max(bits >>> 24, 1)) / 255;
    found[to++] = wide;
    found[to++] = opacity;
  }
  return found.slice(0, to);
}

/** A number ≥ 0 from its binary16 bits. */
function ofHalf(bits: number): number {
  const exponent = bits >> 10;
  const fraction = bits & 1023;
  return exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : fraction * 2 ** -24;
}
