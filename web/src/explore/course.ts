// The centre line of a bent tube.
// Lengths are in millimetres; positions along the line start at the isthmus end of the model.
import type { Course as CourseDocument, Model } from "oviduct-client";
import { intervalAt } from "./ascending.ts";

/** Receives x, y and z. */
interface Target {
  set(x: number, y: number, z: number): unknown;
}

/** Numbers per point of the centre line: position, u, v and tangent. */
const STRIDE = 12;
/** Distance below which a vertex counts as lying on an end, because positions are rounded. */
const AT_END = 0.001;

/** True if the tube of a model is bent or twisted about its axis. */
export function isBent({ spec }: Pick<Model, "spec">): boolean {
  const course = spec?.["course"] as { shape?: string; twist_deg?: number } | undefined;
  return course !== undefined && (course.shape !== "straight" || Boolean(course.twist_deg));
}

export class Course {
  readonly tortuosity: number;
  /** Distance between the ends of the whole tube. */
  readonly endDistance: number;
  /** Twist of the whole tube about its centre line, degrees. */
  readonly turned: number;
  /** Position along the whole tube at which the model begins. */
  readonly begin: number;
  readonly length: number;
  /** Bounding box of the centre line. */
  readonly low: readonly [number, number, number];
  readonly high: readonly [number, number, number];
  readonly #places: Float64Array;
  readonly #frames: Float64Array;

  constructor({ tortuosity, end_distance_mm, twist_deg, from_mm, to_mm, points }: Omit<CourseDocument, "model">) {
    this.tortuosity = tortuosity;
    this.endDistance = end_distance_mm;
    this.turned = twist_deg;
    this.begin = from_mm;
    this.length = to_mm - from_mm;
    this.#places = Float64Array.from(points, ({ s_mm }) => s_mm - from_mm);
    this.#frames = Float64Array.from(points.flatMap(({ position_mm, u, v, tangent }) => [...position_mm, ...u, ...v, ...tangent]));
    const extreme = (of: (...values: number[]) => number) => [0, 1, 2].map((axis) => of(...points.map(({ position_mm }) => position_mm[axis]!)));
    this.low = extreme(Math.min) as [number, number, number];
    this.high = extreme(Math.max) as [number, number, number];
  }

  /** True if the tube is only twisted about its centre line. */
  get isStraight(): boolean {
    return this.tortuosity - 1 < 1e-9;
  }

  /**
   * Bends the point (x, y, z) of the straight tube. Beyond its ends, the bent tube continues
   * straight.
   */
  bend(x: number, y: number, z: number, out: Target): void {
    this.#combine(z, 1, x, y, Math.min(z, 0) + Math.max(z - this.length, 0), out);
  }

  /** Direction in the bent tube of a direction of the straight tube, at a position. */
  turn(x: number, y: number, z: number, place: number, out: Target): void {
    this.#combine(place, 0, x, y, z, out);
  }

  /** Writes a weighted sum of position, u, v and tangent at a place to `out`. */
  #combine(place: number, position: number, u: number, v: number, tangent: number, out: Target): void {
    const at = this.#places;
    const frames = this.#frames;
    const low = intervalAt(at, place);
    const t = Math.max(0, Math.min(1, (place - at[low]!) / (at[low + 1]! - at[low]!)));
    const a = STRIDE * low;
    const b = a + STRIDE;
    let x = 0;
    let y = 0;
    let z = 0;
    for (let k = 0; k < 4; k++) {
      const factor = k === 0 ? position : k === 1 ? u : k === 2 ? v : tangent;
      const [i, j] = [a + 3 * k, b + 3 * k];
      x += factor * (frames[i]! + (frames[j]! - frames[i]!) * t);
      y += factor * (frames[i + 1]! + (frames[j + 1]! - frames[i + 1]!) * t);
      z += factor * (frames[i + 2]! + (frames[j + 2]! - frames[i + 2]!) * t);
    }
    out.set(x, y, z);
  }

  /**
   * Positions of a bent surface's vertices in the straight tube: x and y in the cross section, and
   * the position along the tube.
   *
   * A wall may be closer to another part of the centre line than to its own. Each vertex is
   * therefore searched from the result of a neighbour.
   */
  straighten(positions: Float32Array, index: ArrayLike<number>): Float32Array {
    const straight = new Float32Array(positions.length).fill(NaN);
    const spans = new Int32Array(positions.length / 3);
    const place = (vertex: number, span: number) => (spans[vertex] = this.#straightenVertex(positions, vertex, span, straight));
    const isKnown = (vertex: number) => !Number.isNaN(straight[3 * vertex]!);
    for (;;) {
      const first = this.#nearestToEnd(positions, index, isKnown);
      if (!first) return straight;
      place(first.vertex, first.span);
      // Forwards and backwards alternately, because neighbours are usually close in the index.
      for (let [changed, step] = [true, 3]; changed; step = -step) {
        changed = false;
        for (let t = step > 0 ? 0 : index.length - 3; t >= 0 && t < index.length; t += step) {
          const known = isKnown(index[t]!) ? t : isKnown(index[t + 1]!) ? t + 1 : isKnown(index[t + 2]!) ? t + 2 : -1;
          if (known < 0) continue;
          for (let k = t; k < t + 3; k++) {
            if (isKnown(index[k]!)) continue;
            place(index[k]!, spans[index[known]!]!);
            changed = true;
          }
        }
      }
    }
  }

  /**
   * The vertex nearest to an end of the centre line, and its span.
   *
   * No other part of the tube is that close to an end.
   */
  #nearestToEnd(positions: Float32Array, index: ArrayLike<number>, isKnown: (vertex: number) => boolean): { vertex: number; span: number } | undefined {
    const last = this.#places.length - 1;
    let [found, least] = [undefined as { vertex: number; span: number } | undefined, Infinity];
    for (let t = 0; t < index.length; t++) {
      const vertex = index[t]!;
      if (isKnown(vertex)) continue;
      for (const end of [0, last]) {
        const [p, c] = [3 * vertex, STRIDE * end];
        const distance = Math.hypot(
          positions[p]! - this.#frames[c]!, positions[p + 1]! - this.#frames[c + 1]!, positions[p + 2]! - this.#frames[c + 2]!,
        );
        if (distance < least) [found, least] = [{ vertex, span: Math.min(end, last - 1) }, distance];
      }
    }
    return found;
  }

  /**
   * Writes the straight position of a vertex, searching along the centre line from `span`.
   *
   * Returns the span of the result.
   */
  #straightenVertex(positions: Float32Array, vertex: number, span: number, out: Float32Array): number {
    const p = 3 * vertex;
    const x = positions[p]!;
    const y = positions[p + 1]!;
    const z = positions[p + 2]!;
    const last = this.#places.length - 2;
    let k = span;
    while (k < last && this.#ahead(k + 1, x, y, z) >= 0) k++;
    while (k > 0 && this.#ahead(k, x, y, z) < 0) k--;
    const from = this.#ahead(k, x, y, z);
    const t = from / (from - this.#ahead(k + 1, x, y, z));
    const at = this.#places[k]! + t * (this.#places[k + 1]! - this.#places[k]!);
    out[p] = this.#aside(k, t, 3, x, y, z);
    out[p + 1] = this.#aside(k, t, 6, x, y, z);
    out[p + 2] = Math.abs(at) < AT_END ? 0 : Math.abs(at - this.length) < AT_END ? this.length : at;
    return k;
  }

  /** Distance of a point ahead of the cross section at a point of the centre line. */
  #ahead(k: number, x: number, y: number, z: number): number {
    const f = this.#frames;
    const i = STRIDE * k;
    return (x - f[i]!) * f[i + 9]! + (y - f[i + 1]!) * f[i + 10]! + (z - f[i + 2]!) * f[i + 11]!;
  }

  /** Distance of a point from the centre line in the direction at `offset` in a local frame. */
  #aside(k: number, t: number, offset: number, x: number, y: number, z: number): number {
    const f = this.#frames;
    const i = STRIDE * k;
    const j = i + STRIDE;
    const lerp = (at: number) => f[i + at]! + (f[j + at]! - f[i + at]!) * t;
    return (x - lerp(0)) * lerp(offset) + (y - lerp(1)) * lerp(offset + 1) + (z - lerp(2)) * lerp(offset + 2);
  }
}
