// The visible part of a tube: coarse pictures omit triangles that the camera cannot see.
import type { Tube } from "../framing.ts";
import type { CutPlane } from "./outline.ts";
import type { Patch } from "./surface.ts";

/** A part of the tube along its axis, millimetres. */
export interface Stretch {
  from: number;
  to: number;
}

/**
 * Number of steps per tube length to which stretches are rounded outwards, so that they change
 * rarely.
 */
const STEPS = 24;
/** Margin as a fraction of a step, because vertex positions are rounded. */
const MARGIN = 0.01;

/**
 * Writes to `out` the part of lumen and cut tissue that is visible through the open ends of a
 * stretch.
 *
 * A line of sight at a distance from the axis leaves the tube within its diameter.
 */
export function seenThroughEnds(eye: { x: number; y: number; z: number }, tube: Tube, ends: Stretch, out: Stretch): void {
  const before = Math.max(ends.from - eye.z, eye.z - ends.to);
  const aside = Math.hypot(eye.x - tube.x, eye.y - tube.y) - tube.radius;
  const depth = aside > 0 ? (2 * tube.radius * Math.max(0, before)) / aside : Infinity;
  const atFrom = eye.z < ends.from;
  // Between the planes of the ends and outside the tube, neither end is visible.
  out.from = before > 0 && !atFrom ? ends.to - depth : ends.from;
  out.to = before <= 0 && aside > 0 ? -Infinity : atFrom ? ends.from + depth : ends.to;
  round(out, tube.length);
}

/** Writes to `out` the stretch of the tube within a distance of the camera. */
export function around(z: number, distance: number, tube: Tube, out: Stretch): void {
  out.from = z - distance;
  out.to = z + distance;
  round(out, tube.length);
}

function round(out: Stretch, length: number): void {
  const step = length / STEPS;
  out.from = Math.floor(out.from / step - MARGIN) * step;
  out.to = Math.ceil(out.to / step + MARGIN) * step;
}

/** For each vertex, one bit per plane; set if the vertex is behind the plane. */
let behind = new Uint8Array(0);

/**
 * Writes to `out` the triangles of a patch that are not wholly behind a plane; returns the number
 * of indices.
 *
 * Accepts at most eight planes.
 */
export function select({ straight: positions, index }: Patch, planes: readonly CutPlane[], out: Uint16Array | Uint32Array): number {
  const vertices = positions.length / 3;
  if (behind.length < vertices) behind = new Uint8Array(vertices);
  behind.fill(0, 0, vertices);
  planes.forEach(({ nx, ny, nz, d }, k) => {
    for (let i = 0, p = 0; i < vertices; i++, p += 3) {
      if (positions[p]! * nx + positions[p + 1]! * ny + positions[p + 2]! * nz + d < 0) behind[i]! |= 1 << k;
    }
  });
  let count = 0;
  for (let t = 0; t < index.length; t += 3) {
    const a = index[t]!;
    const b = index[t + 1]!;
    const c = index[t + 2]!;
    if ((behind[a]! & behind[b]! & behind[c]!) !== 0) continue;
    out[count] = a;
    out[count + 1] = b;
    out[count + 2] = c;
    count += 3;
  }
  return count;
}
