// The part of a cross section that its drawing shows.
import type { Box } from "./contours.ts";

interface Point {
  x: number;
  y: number;
}

/** A square around (x, y) with sides of `span`, micrometres; y points up. */
export interface SectionWindow extends Point {
  span: number;
}

/** Minimum span, micrometres. */
const CLOSEST = 10;

/** The window that shows a whole section, from the bounding box of its tissue. */
export function windowOf({ x0, y0, x1, y1 }: Box): SectionWindow {
  return { x: (x0 + x1) / 2, y: (y0 + y1) / 2, span: 1.08 * Math.max(x1 - x0, y1 - y0) };
}

/**
 * The point of the section at a place of the drawing.
 *
 * The place is in pixels from the top left corner of the drawing, which is `side` pixels wide.
 */
export function pointAt({ x, y, span }: SectionWindow, right: number, down: number, side: number): Point {
  return { x: x + (right / side - 0.5) * span, y: y - (down / side - 0.5) * span };
}

/** Zooms by a factor (above 1 zooms out, at most to `whole`); the point `at` stays in place. */
export function zoomed({ x, y, span }: SectionWindow, factor: number, at: Point, whole: SectionWindow): SectionWindow {
  const next = Math.max(CLOSEST, span * factor);
  if (next >= whole.span) return whole;
  return { x: at.x + ((x - at.x) * next) / span, y: at.y + ((y - at.y) * next) / span, span: next };
}

/** Moves with a drag, in pixels of a drawing that is `side` pixels wide. */
export function dragged({ x, y, span }: SectionWindow, right: number, down: number, side: number): SectionWindow {
  return { x: x - (right / side) * span, y: y + (down / side) * span, span };
}
