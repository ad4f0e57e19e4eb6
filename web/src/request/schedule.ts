// Values of parameters, constant or changing along the tube. The interpolation equals that of
// crates/spec/src/spec/schedule.rs.

import { writePoints } from "./text.ts";

/** A schedule key: a fraction of the steps, and the value there. */
export type Key = [at: number, value: number];

export interface Fluctuation {
  /** In the unit of the parameter. */
  amplitude: number;
  /** In steps. */
  period: number;
}

export interface Schedule {
  /** At least two schedule keys; the first at 0, the last at 1. */
  keys: Key[];
  ease: string;
  fluctuation?: Fluctuation | undefined;
}

/** A value as typed: NaN for text that is not a number; points as text. */
export type Value = number | string | boolean | Schedule;

interface Range {
  minimum?: number | undefined;
  maximum?: number | undefined;
}

/** Minimum distance between two schedule keys, as a fraction of the steps. */
export const CLOSEST = 0.001;

/** Reads a value of a resolved spec. A fluctuation without amplitude is omitted. */
export function readValue(json: unknown): Value | undefined {
  if (typeof json === "number" || typeof json === "string" || typeof json === "boolean") return json;
  if (Array.isArray(json) && json.every((item) => Array.isArray(item))) return writePoints(json);
  if (typeof json !== "object" || json === null || !("keys" in json)) return undefined;
  const { keys, ease = "linear", fluctuation } = json as Schedule;
  return { keys, ease, ...(fluctuation?.amplitude ? { fluctuation } : {}) };
}

export function isSchedule(value: Value): value is Schedule {
  return typeof value === "object";
}

export function same(a: Value, b: Value): boolean {
  if (!isSchedule(a) || !isSchedule(b)) return Object.is(a, b);
  return sameKeys(a, b) && a.ease === b.ease && sameFluctuation(a, b);
}

export function sameKeys(a: Schedule, b: Schedule): boolean {
  return a.keys.length === b.keys.length && a.keys.every(([u, v], i) => u === b.keys[i]![0] && v === b.keys[i]![1]);
}

export function sameFluctuation(a: Schedule, b: Schedule): boolean {
  return a.fluctuation?.amplitude === b.fluctuation?.amplitude && a.fluctuation?.period === b.fluctuation?.period;
}

/** The value at `u`, a fraction of the steps, without the fluctuation. */
export function valueAt(value: number | Schedule, u: number): number {
  if (!isSchedule(value)) return value;
  const { keys, ease } = value;
  const next = keys.findIndex(([at]) => at > u);
  if (next === 0) return keys[0]![1];
  if (next < 0) return keys.at(-1)![1];
  const [[u0, v0], [u1, v1]] = [keys[next - 1]!, keys[next]!];
  const x = (u - u0) / (u1 - u0);
  return v0 + (v1 - v0) * (ease === "smooth" ? x * x * (3 - 2 * x) : x);
}

/**
 * Points of the curve from 0 to 1: all schedule keys, and the points that the ease needs in
 * between.
 */
export function curve(value: number | Schedule): Key[] {
  if (!isSchedule(value)) return [[0, value], [1, value]];
  const between = value.ease === "smooth" ? 16 : 1;
  return value.keys.flatMap(([u, v], i): Key[] => {
    const next = value.keys[i + 1];
    if (!next) return [[u, v]];
    return Array.from({ length: between }, (_, k): Key => {
      const at = u + ((next[0] - u) * k) / between;
      return [at, valueAt(value, at)];
    });
  });
}

/** Minimum and maximum value, including the fluctuation. */
export function extent(value: number | Schedule): [number, number] {
  if (!isSchedule(value)) return [value, value];
  const values = value.keys.map(([, v]) => v).filter(Number.isFinite);
  const swing = value.fluctuation?.amplitude || 0;
  return [Math.min(...values) - swing, Math.max(...values) + swing];
}

/**
 * Moves a schedule key within its neighbours and the bounds; the first and the last stay at the
 * ends.
 */
export function moveKey(schedule: Schedule, index: number, [at, value]: Key, bounds: Range): Schedule {
  const { keys } = schedule;
  const low = (keys[index - 1]?.[0] ?? -CLOSEST) + CLOSEST;
  const high = (keys[index + 1]?.[0] ?? 1 + CLOSEST) - CLOSEST;
  const place = index === 0 ? 0 : index === keys.length - 1 ? 1 : clamp(at, low, high);
  return setKey(schedule, index, [round(place, CLOSEST), clamp(value, bounds.minimum ?? -Infinity, bounds.maximum ?? Infinity)]);
}

/** Replaces a schedule key by a typed one, which may be faulty. */
export function setKey(schedule: Schedule, index: number, key: Key): Schedule {
  return { ...schedule, keys: schedule.keys.map((other, i) => (i === index ? key : other)) };
}

/** Adds a schedule key at `u` on the curve; undefined if there is no room. */
export function addKey(schedule: Schedule, u: number, step: number): { schedule: Schedule; index: number } | undefined {
  const at = round(u, CLOSEST);
  const index = schedule.keys.findIndex(([other]) => other > at);
  const [before, after] = [schedule.keys[index - 1], schedule.keys[index]];
  if (!before || !after || at - before[0] < CLOSEST || after[0] - at < CLOSEST) return undefined;
  const key: Key = [at, round(valueAt(schedule, at), step)];
  return { schedule: { ...schedule, keys: schedule.keys.toSpliced(index, 0, key) }, index };
}

/** Removes a schedule key that is not at an end. */
export function removeKey(schedule: Schedule, index: number): Schedule {
  if (index <= 0 || index >= schedule.keys.length - 1) return schedule;
  return { ...schedule, keys: schedule.keys.toSpliced(index, 1) };
}

/** The largest of 1, 2 or 5 times a power of ten below `size`; 0.01 unless `size` is positive. */
export function stepOf(size: number): number {
  if (!(size > 0)) return 0.01;
  const power = 10 ** Math.floor(Math.log10(size));
  const factor = size / power;
  return round((factor < 2 ? 1 : factor < 5 ? 2 : 5) * power, power);
}

/** The nearest multiple of a step, without the rounding errors of binary fractions. */
export function round(value: number, step: number): number {
  return Number((Math.round(value / step) * step).toPrecision(12));
}

function clamp(value: number, low: number, high: number): number {
  return Math.min(Math.max(value, low), high);
}
