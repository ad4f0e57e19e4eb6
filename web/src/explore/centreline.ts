// A path through the lumen: wide places of the sections, connected so that the path is free.
import { intervalAt } from "./ascending.ts";
import type { DistanceField } from "./lumen.ts";

/** Points of the path in millimetres, one per section, from the isthmus end. */
export interface Centreline {
  x: Float64Array;
  y: Float64Array;
  z: Float64Array;
  /** Distance to the mucosa within the section, micrometres. */
  clearance: Float64Array;
}

interface Place {
  x: number;
  y: number;
  clearance: number;
}

/** Maximum number of wide places per section. */
const PLACES = 32;
/** Clearance at which the cost of a narrow place is 1, micrometres. */
const NARROW = 30;
/** Cost per cell of the path in tissue. Crossing a fold costs more than any detour. */
const BLOCKED = 100;
const SMOOTHING = 60;

/**
 * Finds the path through sections at `z` micrometres from their distance fields.
 *
 * Awaits `pause` between portions of the work, so that the page stays responsive.
 */
export async function centreline(
  fields: readonly DistanceField[],
  z: readonly number[],
  pause: () => Promise<void>,
): Promise<Centreline> {
  const way = await cheapest(fields, z, pause);
  await smooth(way, fields, z, pause);
  return {
    x: Float64Array.from(way, (place) => place.x / 1000),
    y: Float64Array.from(way, (place) => place.y / 1000),
    z: Float64Array.from(z, (at) => at / 1000),
    clearance: Float64Array.from(way, (place) => place.clearance),
  };
}

/** Writes the position at `z` millimetres to `out` as x, y, z. */
export function positionAt(line: Centreline, z: number, out: { set(x: number, y: number, z: number): unknown }): void {
  const { x, y, z: at } = line;
  const low = intervalAt(at, z);
  const high = Math.min(low + 1, at.length - 1);
  const span = at[high]! - at[low]!;
  const t = span > 0 ? Math.max(0, Math.min(1, (z - at[low]!) / span)) : 0;
  out.set(x[low]! + (x[high]! - x[low]!) * t, y[low]! + (y[high]! - y[low]!) * t, Math.max(at[0]!, Math.min(at[at.length - 1]!, z)));
}

/** The path of minimum cost through one place per section, by dynamic programming. */
async function cheapest(fields: readonly DistanceField[], z: readonly number[], pause: () => Promise<void>): Promise<Place[]> {
  const choices: Place[][] = [];
  for (const field of fields) {
    choices.push(widePlaces(field));
    await pause();
  }
  const from: Int32Array[] = [];
  let costs = choices[0]!.map(narrowness);
  for (let k = 1; k < choices.length; k++) {
    const back = new Int32Array(choices[k]!.length);
    costs = choices[k]!.map((place, i) => {
      let least = Infinity;
      choices[k - 1]!.forEach((before, j) => {
        const free = costs[j]! + slope(before, place, z[k]! - z[k - 1]!);
        if (free >= least) return;
        const cost = free + BLOCKED * blocked(before, place, fields[k - 1]!, fields[k]!);
        if (cost < least) [least, back[i]] = [cost, j];
      });
      return least + narrowness(place);
    });
    from.push(back);
    await pause();
  }
  let at = costs.indexOf(Math.min(...costs));
  const way: Place[] = [];
  for (let k = choices.length - 1; k >= 0; k--) {
    way.push({ ...choices[k]![at]! });
    if (k > 0) at = from[k - 1]![at]!;
  }
  return way.reverse();
}

function narrowness({ clearance }: Place): number {
  return (NARROW / Math.max(clearance, 1)) ** 2;
}

/** Cost of a sideways step. */
function slope(a: Place, b: Place, dz: number): number {
  return (Math.hypot(b.x - a.x, b.y - a.y) / Math.max(dz, 1)) ** 2;
}

/** Number of tissue cells on the straight line between two sections. */
function blocked(a: Place, b: Place, fieldA: DistanceField, fieldB: DistanceField): number {
  const tests = Math.max(4, Math.ceil(Math.hypot(b.x - a.x, b.y - a.y) / fieldA.cell));
  let count = 0;
  for (let i = 0; i <= tests; i++) {
    const t = i / tests;
    const x = a.x + (b.x - a.x) * t;
    const y = a.y + (b.y - a.y) * t;
    if (fieldA.sample(x, y) * (1 - t) + fieldB.sample(x, y) * t <= 0) count++;
  }
  return count;
}

/**
 * Local maxima of the distance to the mucosa, widest first, none within the clearance of another.
 */
function widePlaces(field: DistanceField): Place[] {
  const maxima: Place[] = [];
  for (let row = 1; row < field.cells - 1; row++) {
    for (let column = 1; column < field.cells - 1; column++) {
      const clearance = field.at(column, row);
      if (clearance > 0 && isMaximum(field, column, row, clearance)) {
        maxima.push({ x: field.x0 + column * field.cell, y: field.y0 + row * field.cell, clearance });
      }
    }
  }
  maxima.sort((a, b) => b.clearance - a.clearance);
  const places: Place[] = [];
  for (const place of maxima) {
    if (places.length === PLACES) break;
    const isNew = places.every((other) => Math.hypot(place.x - other.x, place.y - other.y) > other.clearance);
    if (isNew) places.push(place);
  }
  return places;
}

function isMaximum(field: DistanceField, column: number, row: number, clearance: number): boolean {
  for (let dy = -1; dy <= 1; dy++) {
    for (let dx = -1; dx <= 1; dx++) if (field.at(column + dx, row + dy) > clearance) return false;
  }
  return true;
}

/**
 * Moves points towards the line between their neighbours, if they keep half their clearance and the
 * path stays free.
 */
async function smooth(
  way: Place[],
  fields: readonly DistanceField[],
  z: readonly number[],
  pause: () => Promise<void>,
): Promise<void> {
  const least = way.map((place) => place.clearance / 2);
  const hindrance = (k: number) =>
    (k > 0 ? blocked(way[k - 1]!, way[k]!, fields[k - 1]!, fields[k]!) : 0) +
    (k + 1 < way.length ? blocked(way[k]!, way[k + 1]!, fields[k]!, fields[k + 1]!) : 0);
  for (let round = 0; round < SMOOTHING; round++) {
    await pause();
    for (let k = 1; k + 1 < way.length; k++) {
      const [a, place, b] = [way[k - 1]!, way[k]!, way[k + 1]!];
      const t = (z[k]! - z[k - 1]!) / (z[k + 1]! - z[k - 1]!);
      const [x, y] = [(place.x + a.x + (b.x - a.x) * t) / 2, (place.y + a.y + (b.y - a.y) * t) / 2];
      const clearance = fields[k]!.sample(x, y);
      if (clearance < least[k]!) continue;
      const before = hindrance(k);
      way[k] = { x, y, clearance };
      if (hindrance(k) > before) way[k] = place;
    }
  }
}
