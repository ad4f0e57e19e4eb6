// The face of a cut of a bent tube as triangles: the interior of its closed outlines, by the
// even-odd rule.
import { grown, type Segments } from "./outline.ts";

/** Triangles of a face: their drawn positions, and their positions in the straight tube. */
export interface Face {
  positions: Float32Array<ArrayBuffer>;
  straight: Float32Array<ArrayBuffer>;
  index: Uint32Array<ArrayBuffer>;
}

export type Direction = readonly [number, number, number];

/**
 * Fills outlines in a plane of the straight tube with the directions `right` and `up`.
 *
 * The face consists of trapezoids between two lines and two heights at which lines begin or end.
 */
export function fill(outlines: readonly Segments[], right: Direction, up: Direction): Face {
  const lines = outlines.flatMap((segments) => Array.from({ length: segments.count }, (_, k) => new Line(segments, 6 * k, right, up)));
  const rising = lines.filter(({ bottom, top }) => bottom < top).sort((a, b) => a.bottom - b.bottom);
  const heights = Float64Array.from(rising.flatMap(({ bottom, top }) => [bottom, top])).sort();
  const corners = new Corners();
  /** Ends the trapezoid to the right of a line. */
  const end = (line: Line, at: number) => {
    if (line.partner && line.begun < at) corners.add(line, line.partner, line.begun, at);
    line.partner = undefined;
  };
  const present: Line[] = [];
  let next = 0;
  for (let i = 0; i < heights.length; i++) {
    const at = heights[i]!;
    const above = heights[i + 1] ?? at;
    if (at === above && i + 1 < heights.length) continue;
    let kept = 0;
    for (const line of present) {
      if (line.top > at) present[kept++] = line;
      else end(line, at);
    }
    present.length = kept;
    while (next < rising.length && rising[next]!.bottom <= at) present.push(rising[next++]!);
    const middle = (at + above) / 2;
    for (const line of present) line.x = line.across(middle);
    sort(present);
    for (let j = 0; j < present.length; j++) {
      const line = present[j]!;
      const partner = j % 2 === 0 ? present[j + 1] : undefined;
      if (line.partner === partner) continue;
      end(line, at);
      line.partner = partner;
      line.begun = at;
    }
  }
  return corners.face();
}

/** Sorts from left to right by insertion, because the lines are nearly sorted. */
function sort(lines: Line[]): void {
  for (let i = 1; i < lines.length; i++) {
    const line = lines[i]!;
    let j = i;
    for (; j > 0 && lines[j - 1]!.x > line.x; j--) lines[j] = lines[j - 1]!;
    lines[j] = line;
  }
}

/** A segment of an outline, directed upwards. */
class Line {
  readonly segments: Segments;
  /** Indices of its lower and its upper end in the numbers of the segments. */
  readonly from: number;
  readonly to: number;
  readonly bottom: number;
  readonly top: number;
  readonly #left: number;
  readonly #slope: number;
  /** Position across at the current height. */
  x = 0;
  /** The line at the right of the current trapezoid, and the lower height of the trapezoid. */
  partner: Line | undefined;
  begun = 0;

  constructor(segments: Segments, at: number, right: Direction, up: Direction) {
    const { straight } = segments;
    const along = ([x, y, z]: Direction, i: number) => straight[i]! * x + straight[i + 1]! * y + straight[i + 2]! * z;
    const turned = along(up, at) > along(up, at + 3);
    this.segments = segments;
    this.from = turned ? at + 3 : at;
    this.to = turned ? at : at + 3;
    this.bottom = along(up, this.from);
    this.top = along(up, this.to);
    this.#left = along(right, this.from);
    this.#slope = (along(right, this.to) - this.#left) / (this.top - this.bottom);
  }

  across(height: number): number {
    return this.#left + (height - this.bottom) * this.#slope;
  }
}

/** Corners of trapezoids, four each; the buffer grows as needed. */
class Corners {
  #positions = new Float32Array(4096);
  #straight = new Float32Array(4096);
  #count = 0;

  /** Adds the trapezoid between two lines and two heights. */
  add(left: Line, right: Line, bottom: number, top: number): void {
    this.#add(left, bottom);
    this.#add(right, bottom);
    this.#add(left, top);
    this.#add(right, top);
  }

  #add({ segments: { points, straight }, from, to, bottom, top }: Line, height: number): void {
    const at = 3 * this.#count++;
    if (at + 3 > this.#positions.length) {
      this.#positions = grown(this.#positions);
      this.#straight = grown(this.#straight);
    }
    const t = (height - bottom) / (top - bottom);
    for (let axis = 0; axis < 3; axis++) {
      this.#positions[at + axis] = points[from + axis]! + (points[to + axis]! - points[from + axis]!) * t;
      this.#straight[at + axis] = straight[from + axis]! + (straight[to + axis]! - straight[from + axis]!) * t;
    }
  }

  face(): Face {
    const count = this.#count / 4;
    const index = new Uint32Array(6 * count);
    for (let k = 0; k < count; k++) index.set([4 * k, 4 * k + 1, 4 * k + 2, 4 * k + 2, 4 * k + 1, 4 * k + 3], 6 * k);
    const length = 3 * this.#count;
    return { positions: this.#positions.subarray(0, length), straight: this.#straight.subarray(0, length), index };
  }
}
