// The way of the flight through the lumen, as the service has found and certified it.
import type { Plane, Way as WayDocument } from "oviduct-client";
import { intervalAt } from "./ascending.ts";
import type { Tube } from "./framing.ts";

/** Receives x, y and z. */
interface Target {
  set(x: number, y: number, z: number): unknown;
}

type Ends = Pick<Tube, "begin" | "course">;

/** Smallest step between places of points, millimetres. */
const STEP = 1e-6;
/** Part of the way ahead whose mean direction the flight looks in, millimetres along the tube. */
const AHEAD = 0.7;

/**
 * A polyline through the lumen. Lengths are in millimetres, positions those of the 3D picture.
 *
 * Places are millimetres along the tube from its beginning in the picture.
 */
export class Way {
  readonly #places: Float64Array;
  readonly #positions: Float64Array;
  readonly #clearances: Float64Array;
  readonly #least: number;
  /** Length of the way up to each point. */
  readonly #lengths: Float64Array;
  /** Integral of the unit direction of the way over the place, so that means are differences. */
  readonly #headings: Float64Array;

  constructor({ points, clearance_um }: Pick<WayDocument, "points" | "clearance_um">, { begin, course }: Ends) {
    let last = -Infinity;
    // Where the way has to go back, it moves on within a nanometre along the tube.
    this.#places = Float64Array.from(points, ({ s_mm }) => (last = Math.max(s_mm - begin, last + STEP)));
    // Files of bent tubes, and so the picture, keep the coordinates of the whole tube.
    const shift = course ? 0 : begin;
    this.#positions = Float64Array.from(points.flatMap(({ position_mm: [x, y, z] }) => [x!, y!, z! - shift]));
    this.#clearances = Float64Array.from(points, (point) => point.clearance_um / 1000);
    this.#least = clearance_um / 1000;
    this.#lengths = lengths(this.#positions);
    this.#headings = headings(this.#places, this.#positions);
  }

  /** Writes the position at a place to `out`; beyond the ends, the position of the end. */
  at(place: number, out: Target): void {
    const k = this.#interval(place);
    const t = Math.max(0, Math.min(1, this.#fraction(k, place)));
    const [p, i] = [this.#positions, 3 * k];
    out.set(mix(p, i, t), mix(p, i + 1, t), mix(p, i + 2, t));
  }

  /** Writes the direction in which a flight at a place looks; its length is arbitrary. */
  ahead(place: number, out: Target): void {
    const [from, to] = [this.#interval(place), this.#interval(place + AHEAD)];
    // Beyond its ends, the way goes on straight.
    const [s, t] = [this.#fraction(from, place), this.#fraction(to, place + AHEAD)];
    const [h, i, j] = [this.#headings, 3 * from, 3 * to];
    out.set(mix(h, j, t) - mix(h, i, s), mix(h, j + 1, t) - mix(h, i + 1, s), mix(h, j + 2, t) - mix(h, i + 2, s));
  }

  /**
   * A lower bound of the distance from the mucosa at a place.
   *
   * From a point of the way, the distance decreases at most by the length of the way.
   */
  clearance(place: number): number {
    const k = this.#interval(place);
    const t = Math.max(0, Math.min(1, this.#fraction(k, place)));
    const [p, i] = [this.#positions, 3 * k];
    const length = Math.hypot(p[i + 3]! - p[i]!, p[i + 4]! - p[i + 1]!, p[i + 5]! - p[i + 2]!);
    return Math.max(this.#least, this.#clearances[k]! - t * length, this.#clearances[k + 1]! - (1 - t) * length);
  }

  /** The place after a piece of the way. Where the way leads sideways, places change little. */
  onward(place: number, millimetres: number): number {
    const k = this.#interval(place);
    const at = this.#lengths;
    const length = mix(at, k, Math.max(0, Math.min(1, this.#fraction(k, place))), 1) + millimetres;
    const to = Math.min(intervalAt(at, length), at.length - 2);
    return mix(this.#places, to, (length - at[to]!) / (at[to + 1]! - at[to]!), 1);
  }

  #interval(place: number): number {
    return Math.min(intervalAt(this.#places, place), this.#places.length - 2);
  }

  /** Position in an interval; below 0 or above 1 beyond the ends. */
  #fraction(k: number, place: number): number {
    const at = this.#places;
    return (place - at[k]!) / (at[k + 1]! - at[k]!);
  }
}

function lengths(positions: Float64Array): Float64Array {
  const sums = new Float64Array(positions.length / 3);
  for (let k = 1; k < sums.length; k++) {
    sums[k] = sums[k - 1]! + Math.hypot(...[0, 1, 2].map((axis) => positions[3 * k + axis]! - positions[3 * k + axis - 3]!));
  }
  return sums;
}

function headings(places: Float64Array, positions: Float64Array): Float64Array {
  const sums = new Float64Array(positions.length);
  for (let k = 1; k < places.length; k++) {
    const i = 3 * k;
    const step = [0, 1, 2].map((axis) => positions[i + axis]! - positions[i + axis - 3]!);
    const scale = (places[k]! - places[k - 1]!) / Math.hypot(...step);
    step.forEach((value, axis) => (sums[i + axis] = sums[i + axis - 3]! + value * scale));
  }
  return sums;
}

/** Interpolates between the values of a point and the next one. */
function mix(values: Float64Array, i: number, t: number, stride = 3): number {
  return values[i]! + (values[i + stride]! - values[i]!) * t;
}

/** The camera in the plane of a cut: its position in micrometres, and the direction up. */
export interface Bearing {
  u: number;
  v: number;
  up: readonly [u: number, v: number];
}

/** Where a flight crosses the plane of the cut at a place, `place` millimetres along the tube. */
export function bearing(way: Way, tube: Ends, place: number, { origin_um, u, v }: Plane): Bearing {
  const { begin, course } = tube;
  let [position, up] = [[0, 0, 0], [0, 1, 0]];
  way.at(place, { set: (x, y, z) => (position = [x, y, course ? z : z + begin]) });
  course?.turn(0, 1, 0, place, { set: (x, y, z) => (up = [x, y, z]) });
  const along = (vector: number[], axis: number[]) => axis.reduce((sum, value, k) => sum + value * vector[k]!, 0);
  const offset = position.map((value, k) => 1000 * value - origin_um[k]!);
  return { u: along(offset, u), v: along(offset, v), up: [along(up, u), along(up, v)] };
}
