// Points of the contours of a section, between which distances are measured exactly.
import type { Section } from "oviduct-client";
import { nearest } from "./contours.ts";

/** A point of a contour as it is stored. */
export interface ContourPoint {
  contour: "inner" | "outer";
  index: number;
}

/** The point of either contour that is nearest to a position; micrometres. */
export function nearestPoint({ inner, outer }: Pick<Section, "inner" | "outer">, x: number, y: number): ContourPoint {
  const [a, b] = [nearest(inner, x, y), nearest(outer, x, y)];
  return a.distance <= b.distance ? { contour: "inner", index: a.index } : { contour: "outer", index: b.index };
}

/** Micrometres. */
export function positionOf(section: Pick<Section, "inner" | "outer">, { contour, index }: ContourPoint): { x: number; y: number } {
  const { x, y } = section[contour];
  return { x: x[index]!, y: y[index]! };
}

/** Micrometres. */
export function distanceOf(section: Pick<Section, "inner" | "outer">, a: ContourPoint, b: ContourPoint): number {
  const [from, to] = [positionOf(section, a), positionOf(section, b)];
  return Math.hypot(to.x - from.x, to.y - from.y);
}
