// Distance to the mucosa within a section, on a grid.
import { boundsOf, type Outline } from "./contours.ts";

/** Resolution of stored distances: fractions of a micrometre. */
const STEPS = 4;
const FAR = 1e12;

/** Signed distance to a contour in micrometres, positive inside the lumen. */
export class DistanceField {
  readonly #values: Int16Array;
  /** Number of cells per side. */
  readonly cells: number;
  /** Side of a cell, micrometres. */
  readonly cell: number;
  /** Centre of the first cell. */
  readonly x0: number;
  readonly y0: number;

  constructor(contour: Outline, cells = 256) {
    const box = boundsOf(contour);
    this.cells = cells;
    this.cell = Math.max(box.x1 - box.x0, box.y1 - box.y0) / (cells - 4);
    this.x0 = (box.x0 + box.x1) / 2 - (this.cell * (cells - 1)) / 2;
    this.y0 = (box.y0 + box.y1) / 2 - (this.cell * (cells - 1)) / 2;
    const lumen = this.#fill(contour);
    const [within, without] = [new Float64Array(cells * cells), new Float64Array(cells * cells)];
    for (let i = 0; i < lumen.length; i++) {
      within[i] = lumen[i] ? FAR : 0;
      without[i] = lumen[i] ? 0 : FAR;
    }
    squaredDistances(within, cells);
    squaredDistances(without, cells);
    this.#values = new Int16Array(cells * cells);
    for (let i = 0; i < lumen.length; i++) {
      const distance = lumen[i] ? Math.sqrt(within[i]!) - 0.5 : 0.5 - Math.sqrt(without[i]!);
      this.#values[i] = Math.max(-32767, Math.min(32767, Math.round(distance * this.cell * STEPS)));
    }
  }

  /** Distance at the centre of a cell. */
  at(column: number, row: number): number {
    return this.#values[row * this.cells + column]! / STEPS;
  }

  /** Distance at a position, interpolated between cells. */
  sample(x: number, y: number): number {
    const last = this.cells - 1.001;
    const u = clamp((x - this.x0) / this.cell, last);
    const v = clamp((y - this.y0) / this.cell, last);
    const column = Math.floor(u);
    const row = Math.floor(v);
    const a = u - column;
    const b = v - row;
    const below = this.at(column, row) * (1 - a) + this.at(column + 1, row) * a;
    const above = this.at(column, row + 1) * (1 - a) + this.at(column + 1, row + 1) * a;
    return below * (1 - b) + above * b;
  }

  /** Marks the cells whose centres are inside the contour. */
  #fill({ x, y }: Outline): Uint8Array {
    const { cells, cell, x0, y0 } = this;
    const crossings: number[][] = Array.from({ length: cells }, () => []);
    for (let i = 0, j = x.length - 1; i < x.length; j = i++) {
      const [low, high] = y[i]! < y[j]! ? [i, j] : [j, i];
      const first = Math.ceil((y[low]! - y0) / cell);
      const last = Math.ceil((y[high]! - y0) / cell);
      const slope = (x[high]! - x[low]!) / (y[high]! - y[low]!);
      for (let row = first; row < last; row++) crossings[row]!.push(x[low]! + (y0 + row * cell - y[low]!) * slope);
    }
    const inside = new Uint8Array(cells * cells);
    crossings.forEach((at, row) => {
      at.sort((a, b) => a - b);
      for (let k = 0; k + 1 < at.length; k += 2) {
        const first = Math.ceil((at[k]! - x0) / cell);
        const last = Math.ceil((at[k + 1]! - x0) / cell);
        inside.fill(1, row * cells + first, row * cells + last);
      }
    });
    return inside;
  }
}

function clamp(value: number, last: number): number {
  return Math.max(0, Math.min(last, value));
}

/**
 * Replaces 0 (target) and FAR by squared distances to the nearest target, in cells.
 *
 * Method: Felzenszwalb and Huttenlocher 2012.
 */
function squaredDistances(grid: Float64Array, cells: number): void {
  const line = new Float64Array(cells);
  const vertices = new Int32Array(cells);
  const borders = new Float64Array(cells + 1);
  for (let column = 0; column < cells; column++) lowerEnvelope(grid, column, cells, cells, line, vertices, borders);
  for (let row = 0; row < cells; row++) lowerEnvelope(grid, row * cells, 1, cells, line, vertices, borders);
}

function lowerEnvelope(
  grid: Float64Array,
  start: number,
  stride: number,
  count: number,
  line: Float64Array,
  vertices: Int32Array,
  borders: Float64Array,
): void {
  for (let i = 0; i < count; i++) line[i] = grid[start + i * stride]!;
  let last = 0;
  vertices[0] = 0;
  borders[0] = -Infinity;
  borders[1] = Infinity;
  for (let i = 1; i < count; i++) {
    let border: number;
    do {
      const vertex = vertices[last]!;
      border = (line[i]! + i * i - line[vertex]! - vertex * vertex) / (2 * (i - vertex));
    } while (border <= borders[last]! && last-- > 0);
    last++;
    vertices[last] = i;
    borders[last] = border;
    borders[last + 1] = Infinity;
  }
  for (let i = 0, k = 0; i < count; i++) {
    while (borders[k + 1]! < i) k++;
    const vertex = vertices[k]!;
    grid[start + i * stride] = (i - vertex) ** 2 + line[vertex]!;
  }
}
