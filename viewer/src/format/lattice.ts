/** Positions and grid coordinates from lattice coordinates. */

import type { Header } from "./file-index";

const f = Math.fround;

/** Coordinate of a lattice number: float32(float64(lattice) · voxel), the canonical formula. */
export function latticePosition(lattice: number, voxel: number): number {
  return f(lattice * voxel);
}

/** A position's grid coordinates in [0, 1], float32, into out[at…at + 3]. */
export function gridCoordinates(
  header: Header,
  x: number,
  y: number,
  z: number,
  out: Float32Array,
  at: number,
): void {
  const radius = f(header.radius);
  const a = f(f(x - f(header.center_x)) / radius);
  const b = f(f(y - f(header.center_y)) / radius);
  const c = f(f(z - f(header.center_z)) / radius);
  if (!header.contract) {
    out[at] = unit(f(f(a + 1) / 2));
    out[at + 1] = unit(f(f(b + 1) / 2));
    out[at + 2] = unit(f(f(c + 1) / 2));
    return;
  }
  const norm = f(Math.sqrt(f(f(f(a * a) + f(b * b)) + f(c * c))));
  const pull = norm > 1 ? f(f(2 - f(1 / norm)) / norm) : 1;
  out[at] = unit(f(f(f(pull * a) + 2) / 4));
  out[at + 1] = unit(f(f(f(pull * b) + 2) / 4));
  out[at + 2] = unit(f(f(f(pull * c) + 2) / 4));
}

function unit(value: number): number {
  return Math.min(1, Math.max(0, value));
}
