// What a camera can see of a tube: coarse pictures leave out triangles that it cannot.
import type { Tube } from "../framing.ts";
import type { CutPlane } from "./outline.ts";
import type { Patch } from "./surface.ts";

/** A part of the tube along its axis, millimetres. */
export interface Stretch {
  from: number;
  to: number;
}

/** Parts of the tube's length that stretches are rounded out to, so that they change only now and then. */
const STEPS = 24;
/** Part of a step: positions of vertices are rounded. */
const MARGIN = 0.01;

/**
 * Writes to `out` how far into the lumen and the cut tissue one sees from outside, through an open end of a stretch of the tube:
 * a line of sight that is aside of the axis leaves the tube after its diameter.
 */
export function seenThroughEnds(eye: { x: number; y: number; z: number }, tube: Tube, ends: Stretch, out: Stretch): void {
  const before = Math.max(ends.from - eye.z, eye.z - ends.to);
  const aside = Math.hypot(eye.x - tube.x, eye.y - tube.y) - tube.radius;
  const depth = aside > 0 ? (2 * tube.radius * Math.max(0, before)) / aside : Infinity;
  const atFrom = eye.z < ends.from;
  // Between the ends, aside of the tube, one sees neither.
  out.from = before > 0 && !atFrom ? ends.to - depth : ends.from;
  out.to = before <= 0 && aside > 0 ? -Infinity : atFrom ? ends.from + depth : ends.to;
  round(out, tube.length);
}

/** Writes to `out` the stretch around a camera within a distance of it. */
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

/** For each vertex, a bit for each plane that it lies behind. */
let behind = new Uint8Array(0);

/** Writes to `out` the triangles of a patch but those that lie wholly behind a plane; the number of indices. At most eight planes. */
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
