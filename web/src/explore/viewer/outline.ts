// Where a plane crosses a surface.
import type { Patch } from "./surface.ts";

/** Points with x·nx + y·ny + z·nz + d = 0; what is on the negative side is cut away. */
export interface CutPlane {
  nx: number;
  ny: number;
  nz: number;
  d: number;
}

/** Line segments, six numbers each; grows as needed and is used again. */
export class Segments {
  points = new Float32Array(6 * 4096);
  count = 0;

  clear(): void {
    this.count = 0;
  }

  /** Room for one more segment: its place in `points`. */
  next(): number {
    const at = 6 * this.count++;
    if (at + 6 > this.points.length) {
      const more = new Float32Array(2 * this.points.length);
      more.set(this.points);
      this.points = more;
    }
    return at;
  }
}

let distances = new Float32Array(0);

/** Adds the segments in which a plane crosses the triangles of a patch. */
export function addOutline({ positions, index }: Patch, { nx, ny, nz, d }: CutPlane, out: Segments): void {
  const vertices = positions.length / 3;
  if (distances.length < vertices) distances = new Float32Array(vertices);
  for (let i = 0, p = 0; i < vertices; i++, p += 3) {
    distances[i] = positions[p]! * nx + positions[p + 1]! * ny + positions[p + 2]! * nz + d;
  }
  for (let t = 0; t < index.length; t += 3) {
    const a = index[t]!;
    const b = index[t + 1]!;
    const c = index[t + 2]!;
    const keptA = distances[a]! >= 0;
    const keptB = distances[b]! >= 0;
    const keptC = distances[c]! >= 0;
    if (keptA === keptB && keptB === keptC) continue;
    // The vertex that is alone on its side, and the two others.
    const [tip, left, right] = keptA === keptB ? [c, a, b] : keptA === keptC ? [b, c, a] : [a, b, c];
    const at = out.next();
    cross(positions, tip, left, out.points, at);
    cross(positions, tip, right, out.points, at + 3);
  }
}

function cross(positions: Float32Array, a: number, b: number, out: Float32Array, at: number): void {
  const t = distances[a]! / (distances[a]! - distances[b]!);
  for (let k = 0; k < 3; k++) {
    const from = positions[3 * a + k]!;
    out[at + k] = from + (positions[3 * b + k]! - from) * t;
  }
}
