// Geometry of contours for drawing: x and y of the points alternately, micrometres.
import type { Contour } from "../models.ts";

export interface Bounds {
  x: [number, number];
  y: [number, number];
}

/** Bounding box of contours; undefined without points. */
export function bounds(contours: Iterable<Contour>): Bounds | undefined {
  const box: Bounds = { x: [Infinity, -Infinity], y: [Infinity, -Infinity] };
  for (const contour of contours) {
    for (let at = 0; at < contour.length; at += 2) {
      widen(box.x, contour[at]!);
      widen(box.y, contour[at + 1]!);
    }
  }
  return box.x[0] <= box.x[1] ? box : undefined;
}

function widen(range: [number, number], value: number): void {
  range[0] = Math.min(range[0], value);
  range[1] = Math.max(range[1], value);
}

/** At most `most` points of a contour, evenly chosen. */
export function thinned(contour: Contour, most: number): Contour {
  const points = contour.length / 2;
  if (points <= most) return contour;
  const kept = new Float32Array(2 * most);
  for (let k = 0; k < most; k++) {
    const from = 2 * Math.floor((k * points) / most);
    kept[2 * k] = contour[from]!;
    kept[2 * k + 1] = contour[from + 1]!;
  }
  return kept;
}

/**
 * The contour as `count` points at equal distances along it.
 *
 * It begins at the point whose direction from the centre is closest to angle 0. Equal indices in
 * the outer contours of neighbouring sections therefore face each other.
 */
export function evenly(contour: Contour, count: number): Contour {
  const points = contour.length / 2;
  const first = rightmost(contour);
  const lengths = new Float64Array(points + 1);
  const x = (k: number) => contour[2 * ((first + k) % points)]!;
  const y = (k: number) => contour[2 * ((first + k) % points) + 1]!;
  for (let k = 0; k < points; k++) {
    lengths[k + 1] = lengths[k]! + Math.hypot(x(k + 1) - x(k), y(k + 1) - y(k));
  }
  const even = new Float32Array(2 * count);
  let edge = 0;
  for (let k = 0; k < count; k++) {
    const target = (k * lengths[points]!) / count;
    while (edge < points - 1 && lengths[edge + 1]! <= target) edge++;
    const part = (target - lengths[edge]!) / (lengths[edge + 1]! - lengths[edge]! || 1);
    even[2 * k] = x(edge) + part * (x(edge + 1) - x(edge));
    even[2 * k + 1] = y(edge) + part * (y(edge + 1) - y(edge));
  }
  return even;
}

/** Index of the point whose direction from the centre is closest to that of the x axis. */
function rightmost(contour: Contour): number {
  const points = contour.length / 2;
  let [cx, cy] = [0, 0];
  for (let k = 0; k < points; k++) {
    cx += contour[2 * k]! / points;
    cy += contour[2 * k + 1]! / points;
  }
  let [best, least] = [0, Infinity];
  for (let k = 0; k < points; k++) {
    const angle = Math.abs(Math.atan2(contour[2 * k + 1]! - cy, contour[2 * k]! - cx));
    if (angle < least) [best, least] = [k, angle];
  }
  return best;
}

/** The longest round length (1, 2 or 5 times a power of ten) up to `most`. */
export function roundLength(most: number): number {
  const power = 10 ** Math.floor(Math.log10(most));
  const factor = most / power;
  return power * (factor >= 5 ? 5 : factor >= 2 ? 2 : 1);
}
