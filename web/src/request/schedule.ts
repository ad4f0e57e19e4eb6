// Values of parameters, constant or changing along the tube. The interpolation equals that of
// crates/spec/src/spec/schedule.rs.

import { writePoints } from "./text.ts";

/** A fraction of the steps, and the value there. */
export type Key = [at: number, value: number];

export interface Fluctuation {
  /** In the unit of the parameter. */
  amplitude: number;
  /** In steps. */
  period: number;
}

export interface Schedule {
  /** At least two; the first at 0, the last at 1. */
  keys: Key[];
  ease: string;
  fluctuation?: Fluctuation | undefined;
}

/** A number that is not one (NaN) is what was typed so far. Points are their text. */
export type Value = number | string | boolean | Schedule;

interface Range {
  minimum?: number | undefined;
  maximum?: number | undefined;
}

/** Least distance of two keys, in fractions of the steps. */
export const CLOSEST = 0.001;

/** Reads a value of a resolved spec. A fluctuation without amplitude is none. */
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

/** Points of the curve from 0 to 1: all keys, and what the ease needs between them. */
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

/** Least and greatest value, with the fluctuation. */
export function extent(value: number | Schedule): [number, number] {
  if (!isSchedule(value)) return [value, value];
  const values = value.keys.map(([, v]) => v).filter(Number.isFinite);
  const swing = value.fluctuation?.amplitude || 0;
  return [Math.min(...values) - swing, Math.max(...values) + swing];
}

/** Moves a key as far as its neighbours and the bounds allow; the first and the last stay at the ends. */
export function moveKey(schedule: Schedule, index: number, [at, value]: Key, bounds: Range): Schedule {
  const { keys } = schedule;
  const low = (keys[index - 1]?.[0] ?? -CLOSEST) + CLOSEST;
  const high = (keys[index + 1]?.[0] ?? 1 + CLOSEST) - CLOSEST;
  const place = index === 0 ? 0 : index === keys.length - 1 ? 1 : clamp(at, low, high);
  return setKey(schedule, index, [round(place, CLOSEST), clamp(value, bounds.minimum ?? -Infinity, bounds.maximum ?? Infinity)]);
}

/** Replaces a key by one that was typed, which may be faulty. */
export function setKey(schedule: Schedule, index: number, key: Key): Schedule {
  return { ...schedule, keys: schedule.keys.map((other, i) => (i === index ? key : other)) };
}

/** Adds a key at `u`, on the curve. Undefined if there is no room. */
export function addKey(schedule: Schedule, u: number, step: number): { schedule: Schedule; index: number } | undefined {
  const at = round(u, CLOSEST);
  const index = schedule.keys.findIndex(([other]) => other > at);
  const [before, after] = [schedule.keys[index - 1], schedule.keys[index]];
  if (!before || !after || at - before[0] < CLOSEST || after[0] - at < CLOSEST) return undefined;
  const key: Key = [at, round(valueAt(schedule, at), step)];
  return { schedule: { ...schedule, keys: schedule.keys.toSpliced(index, 0, key) }, index };
}

/** Removes a key that is not at an end. */
export function removeKey(schedule: Schedule, index: number): Schedule {
  if (index <= 0 || index >= schedule.keys.length - 1) return schedule;
  return { ...schedule, keys: schedule.keys.toSpliced(index, 1) };
}

/** 1, 2 or 5 times a power of ten: the greatest below `size`, a positive number; or else 0.01. */
export function stepOf(size: number): number {
  if (!(size > 0)) return 0.01;
  const power = 10 ** Math.floor(Math.log10(size));
  const factor = size / power;
  return round((factor < 2 ? 1 : factor < 5 ? 2 : 5) * power, power);
}

/** The nearest multiple of a step, without the noise of binary fractions. */
export function round(value: number, step: number): number {
  return Number((Math.round(value / step) * step).toPrecision(12));
}

function clamp(value: number, low: number, high: number): number {
  return Math.min(Math.max(value, low), high);
}
