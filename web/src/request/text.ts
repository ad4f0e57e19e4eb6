// Numbers and lists as people type them.

const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;
/** More are not written out; the service refuses as many. */
const MOST_SEEDS = 10_000;

/** NaN if the text is not a number. */
export function readNumber(text: string): number {
  const trimmed = text.trim();
  const value = NUMBER.test(trimmed) ? Number(trimmed) : NaN;
  return Number.isFinite(value) ? value : NaN;
}

function parts(text: string): string[] {
  return text.split(/[,;\s]+/).filter(Boolean);
}

/** Seeds such as `1..10, 42`; or what is wrong with them. */
export function readSeeds(text: string): number[] | string {
  const seeds: number[] = [];
  for (const part of parts(text.replace(/\s*\.\.\s*/g, ".."))) {
    const range = /^(\d+)\.\.(\d+)$/.exec(part);
    if (!range) {
      const seed = readNumber(part);
      if (Number.isNaN(seed)) return `“${part}” is neither a number nor a range such as 1..10`;
      seeds.push(seed);
      continue;
    }
    const [from, to] = [Number(range[1]), Number(range[2])];
    if (to < from) return `the range ${part} must go from the smaller number to the greater one`;
    if (!Number.isSafeInteger(to)) return `the range ${part} goes beyond 2^53`;
    if (seeds.length + to - from >= MOST_SEEDS) return `there are more than ${MOST_SEEDS.toLocaleString("en")} seeds`;
    for (let seed = from; seed <= to; seed++) seeds.push(seed);
  }
  return seeds;
}

/** Values of a parameter such as `25, 30, 40` or `rk4, euler`. */
export function readList(text: string): (number | string | boolean)[] {
  return parts(text).map((part) => {
    const value = readNumber(part);
    if (!Number.isNaN(value)) return value;
    return part === "true" || part === "false" ? part === "true" : part;
  });
}
