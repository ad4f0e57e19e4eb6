// Numbers, sizes and times in words.

const bytesUnits = ["bytes", "kB", "MB", "GB", "TB"];

/** `1.3 MB`; units are powers of 1000. */
export function bytes(count: number): string {
  let unit = 0;
  while (count >= 999.5 && unit < bytesUnits.length - 1) {
    count /= 1000;
    unit++;
  }
  return `${unit === 0 ? count : short(count)} ${bytesUnits[unit]}`;
}

/** Three significant digits, thousands separated: `1.62`, `790,211`. */
export function short(value: number): string {
  if (Number.isInteger(value) || Math.abs(value) >= 1000) return Math.round(value).toLocaleString("en");
  return Number(value.toPrecision(3)).toLocaleString("en", { maximumSignificantDigits: 3 });
}

/** `2.4 s`, `3 min 10 s`, `2 h 5 min`. */
export function duration(seconds: number): string {
  if (seconds < 10) return `${Number(seconds.toPrecision(2))} s`;
  const whole = Math.round(seconds);
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min${whole % 60 ? ` ${whole % 60} s` : ""}`;
  return `${Math.floor(whole / 3600)} h${Math.floor((whole % 3600) / 60) ? ` ${Math.floor((whole % 3600) / 60)} min` : ""}`;
}

/** `just now`, `5 min ago`, or a date. */
export function ago(time: string, now: number): string {
  const seconds = (now - Date.parse(time)) / 1000;
  if (seconds < 45) return "just now";
  if (seconds < 3600) return `${Math.max(1, Math.round(seconds / 60))} min ago`;
  if (seconds < 86_400) return `${Math.round(seconds / 3600)} h ago`;
  return new Date(time).toLocaleDateString(undefined, { dateStyle: "medium" });
}

/** Lengths of models side by side: `12.3 mm`, or `12.3 and 9.8 mm` if they differ. */
export function millimetres(lengths: readonly number[]): string {
  return `${[...new Set(lengths.map(short))].join(" and ")} mm`;
}

/** A length given in micrometres: `820 nm`, `35.2 µm`, `1.25 mm`. */
export function micrometres(length: number): string {
  if (length < 1) return `${short(length * 1000)} nm`;
  return length < 1000 ? `${short(length)} µm` : `${short(length / 1000)} mm`;
}

/** An area given in square micrometres: `1,730 µm²`, `0.44 mm²`. */
export function squareMicrometres(area: number): string {
  const digits = Number(area.toPrecision(3));
  return digits < 100_000 ? `${short(digits)} µm²` : `${short(digits / 1e6)} mm²`;
}
