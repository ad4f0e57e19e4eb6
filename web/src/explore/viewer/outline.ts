// Intersection of a plane with a surface.
import type { Patch } from "./surface.ts";

/** The plane x·nx + y·ny + z·nz + d = 0 of the straight tube; its negative side is cut away. */
export interface CutPlane {
  nx: number;
  ny: number;
  nz: number;
  d: number;
}

/** Line segments, six numbers each; the buffers grow as needed and are reused. */
export class Segments {
  points = new Float32Array(6 * 4096);
  /** Positions in the straight tube; a different array if the tube is bent. */
  straight = this.points;
  count = 0;

  constructor(bent = false) {
    if (bent) this.straight = new Float32Array(this.points.length);
  }

  clear(): void {
    this.count = 0;
  }

  /** Reserves one more segment; returns its place in `points`. */
  next(): number {
    const at = 6 * this.count++;
    if (at + 6 > this.points.length) {
      const bent = this.straight !== this.points;
      this.points = grown(this.points);
      this.straight = bent ? grown(this.straight) : this.points;
    }
    return at;
  }
}

export function grown(numbers: Float32Array): Float32Array<ArrayBuffer> {
  const more = new Float32Array(2 * numbers.length);
  more.set(numbers);
  return more;
}

let distances = new Float32Array(0);

/** Adds the segments in which a plane crosses the triangles of a patch. */
export function addOutline({ positions, straight, index }: Patch, { nx, ny, nz, d }: CutPlane, out: Segments): void {
  const vertices = positions.length / 3;
  const bent = out.straight !== out.points;
  if (distances.length < vertices) distances = new Float32Array(vertices);
  for (let i = 0, p = 0; i < vertices; i++, p += 3) {
    distances[i] = straight[p]! * nx + straight[p + 1]! * ny + straight[p + 2]! * nz + d;
  }
  for (let t = 0; t < index.length; t += 3) {
    const a = index[t]!;
    const b = index[t + 1]!;
    const c = index[t + 2]!;
    const keptA = distances[a]! >= 0;
    const keptB = distances[b]! >= 0;
    const keptC = distances[c]! >= 0;
    if (keptA === keptB && keptB === keptC) continue;
    // The vertex that is alone on its side of the plane, then the two others.
    const [tip, left, right] = keptA === keptB ? [c, a, b] : keptA === keptC ? [b, c, a] : [a, b, c];
    const at = out.next();
    cross(positions, tip, left, out.points, at);
    cross(positions, tip, right, out.points, at + 3);
    if (!bent) continue;
    cross(straight, tip, left, out.straight, at);
    cross(straight, tip, right, out.straight, at + 3);
  }
}

function cross(positions: Float32Array, one: number, other: number, out: Float32Array, at: number): void {
  // Order the vertices, so that both triangles of an edge get the same point.
  const a = Math.min(one, other);
  const b = Math.max(one, other);
  const t = distances[a]! / (distances[a]! - distances[b]!);
  for (let k = 0; k < 3; k++) {
    const from = positions[3 * a + k]!;
    out[at + k] = from + (positions[3 * b + k]! - from) * t;
  }
}
