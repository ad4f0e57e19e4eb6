// Numbers, lists and points as users type them.

const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;
/** Maximum number of seeds that are written out; the service refuses more. */
const MOST_SEEDS = 10_000;

/** The number in a text; NaN if it is not a number. */
export function readNumber(text: string): number {
  const trimmed = text.trim();
  const value = NUMBER.test(trimmed) ? Number(trimmed) : NaN;
  return Number.isFinite(value) ? value : NaN;
}

function parts(text: string): string[] {
  return text.split(/[,;\s]+/).filter(Boolean);
}

/** Reads seeds such as `1..10, 42`; returns a description of the fault for invalid text. */
export function readSeeds(text: string): number[] | string {
  const seeds: number[] = [];
  for (const part of parts(text.replace(/\s*\.\.\s*/g, ".."))) {
    const [, first, last = first] = /^(\d+)(?:\.\.(\d+))?$/.exec(part) ?? [];
    if (first === undefined) return `“${part}” is neither a seed nor a range such as 1..10`;
    const [from, to] = [Number(first), Number(last)];
    // Above this integer, adding 1 may not change the number.
    if (Math.max(from, to) > Number.MAX_SAFE_INTEGER) return `${part} exceeds ${Number.MAX_SAFE_INTEGER}, the greatest seed`;
    if (to < from) return `the range ${part} must go from the smaller number to the greater one`;
    if (seeds.length + to - from >= MOST_SEEDS) return `there are more than ${MOST_SEEDS.toLocaleString("en")} seeds`;
    for (let seed = from; seed <= to; seed++) seeds.push(seed);
  }
  return seeds;
}

/**
 * Reads values such as `25, 30, 40` or `rk4, euler`; returns a description of the fault for invalid
 * text.
 */
export function readList(text: string): (number | string | boolean)[] | string {
  const mixed = text.includes(";") && text.split(";").find((part) => part.includes(","));
  if (mixed) return `“${mixed.trim()}” has a comma between semicolons; write decimals with a point, and separate values by one of the two`;
  return parts(text).map((part) => {
    const value = readNumber(part);
    if (!Number.isNaN(value)) return value;
    return part === "true" || part === "false" ? part === "true" : part;
  });
}

/**
 * Reads points such as `0, 0, 12`, one per line or as JSON; returns a description of the fault.
 *
 * With 0 coordinates, reads a square of numbers.
 */
export function readPoints(text: string, coordinates: number): number[][] | string {
  const lines = text.replace(/\]\s*,\s*\[/g, "\n").replace(/[[\]]/g, " ").split("\n").filter((line) => line.trim() !== "");
  const points = lines.map((line) => parts(line).map(readNumber));
  const count = coordinates || points.length;
  const wrong = points.findIndex((point) => point.length !== count || point.some(Number.isNaN));
  if (wrong < 0) return points;
  const line = `${wrong + 1}, “${lines[wrong]!.trim()}”, is not`;
  if (coordinates === 0) return `row ${line} ${count} numbers: as many as there are rows`;
  return coordinates === 2 ? `point ${line} two numbers such as 0.5, -1` : `point ${line} three numbers such as 0, 0, 12`;
}

/** One point per line. */
export function writePoints(points: readonly (readonly number[])[]): string {
  return points.map((point) => point.join(", ")).join("\n");
}
