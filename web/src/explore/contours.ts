// Plane geometry of contours: closed polygons in micrometres, counter-clockwise.

/** Coordinates of a closed polygon, one element per point. */
export interface Outline {
  x: ArrayLike<number>;
  y: ArrayLike<number>;
}

export interface Box {
  x0: number;
  y0: number;
  x1: number;
  y1: number;
}

/** Area in square micrometres; negative if the outline is clockwise. */
export function area({ x, y }: Outline): number {
  let twice = 0;
  for (let i = 0, j = x.length - 1; i < x.length; j = i++) twice += x[j]! * y[i]! - x[i]! * y[j]!;
  return twice / 2;
}

/** True if the point is inside, by the even-odd rule. */
export function contains({ x, y }: Outline, px: number, py: number): boolean {
  let inside = false;
  for (let i = 0, j = x.length - 1; i < x.length; j = i++) {
    const [yi, yj] = [y[i]!, y[j]!];
    if (yi > py !== yj > py && px < x[i]! + ((py - yi) / (yj - yi)) * (x[j]! - x[i]!)) inside = !inside;
  }
  return inside;
}

/** Index of the outline's point nearest to (px, py), and its distance in micrometres. */
export function nearest({ x, y }: Outline, px: number, py: number): { index: number; distance: number } {
  let [index, least] = [0, Infinity];
  for (let i = 0; i < x.length; i++) {
    const square = (x[i]! - px) ** 2 + (y[i]! - py) ** 2;
    if (square < least) [index, least] = [i, square];
  }
  return { index, distance: Math.sqrt(least) };
}

export function boundsOf({ x, y }: Outline): Box {
  const box = { x0: Infinity, y0: Infinity, x1: -Infinity, y1: -Infinity };
  for (let i = 0; i < x.length; i++) {
    box.x0 = Math.min(box.x0, x[i]!);
    box.x1 = Math.max(box.x1, x[i]!);
    box.y0 = Math.min(box.y0, y[i]!);
    box.y1 = Math.max(box.y1, y[i]!);
  }
  return box;
}

/** The outline without points that are closer than `step` to the last kept one, for small pictures. */
export function thinned({ x, y }: Outline, step: number): Outline {
  const [keptX, keptY]: [number[], number[]] = [[], []];
  for (let i = 0; i < x.length; i++) {
    if (i > 0 && Math.hypot(x[i]! - keptX.at(-1)!, y[i]! - keptY.at(-1)!) < step) continue;
    keptX.push(x[i]!);
    keptY.push(y[i]!);
  }
  return { x: keptX, y: keptY };
}

/** Data of an SVG path, rounded to hundredths of a micrometre. */
export function pathData({ x, y }: Outline): string {
  let data = "";
  for (let i = 0; i < x.length; i++) data += `${i === 0 ? "M" : "L"}${round(x[i]!)} ${round(y[i]!)}`;
  return `${data}Z`;
}

function round(value: number): number {
  return Math.round(value * 100) / 100;
}
