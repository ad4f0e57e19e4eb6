// Points of a cross section's contours, between which distances are exact.
import { nearest, type Outline } from "./contours.ts";

/** A stored point of a contour. */
export interface ContourPoint {
  /** Index of the contour. */
  contour: number;
  index: number;
}

/** The point of any contour that is nearest to a position, micrometres. */
export function nearestPoint(contours: readonly Outline[], x: number, y: number): ContourPoint {
  const found = contours.map((contour) => nearest(contour, x, y));
  const least = Math.min(...found.map(({ distance }) => distance));
  const contour = found.findIndex(({ distance }) => distance === least);
  return { contour, index: found[contour]!.index };
}

/** Position of a point, micrometres. */
export function positionOf(contours: readonly Outline[], { contour, index }: ContourPoint): { x: number; y: number } {
  const { x, y } = contours[contour]!;
  return { x: x[index]!, y: y[index]! };
}

/** Distance between two points, micrometres. */
export function distanceOf(contours: readonly Outline[], a: ContourPoint, b: ContourPoint): number {
  const [from, to] = [positionOf(contours, a), positionOf(contours, b)];
  return Math.hypot(to.x - from.x, to.y - from.y);
}
