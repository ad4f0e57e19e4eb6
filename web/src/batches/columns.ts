// The table of a study: shown columns, their names, and the order of rows.
import type { Table } from "oviduct-client";

export type Cell = Table["rows"][number][number];

export interface Column {
  /** Name of the column in the table of the service. */
  key: string;
  /** Index of the column in a row. */
  at: number;
  title: string;
  unit?: string;
}

/** Measures that distinguish models. The CSV file contains all measures. */
const FIGURES: readonly { key: string; title: string; unit?: string }[] = [
  { key: "summary.volume_mm3", title: "Tissue volume", unit: "mm³" },
  { key: "summary.area_mm2", title: "Surface", unit: "mm²" },
  { key: "summary.min_gap_um", title: "Smallest gap", unit: "µm" },
  { key: "summary.particles.end", title: "Particles at the end" },
  { key: "summary.splits_missing", title: "Missing splits" },
  { key: "summary.triangles", title: "Triangles" },
];

/** The seed, the varied parameters, and the key measures that the table contains. */
export function columns(table: Table, schema: Schema | undefined): { varied: Column[]; figures: Column[]; seed: Column } {
  const at = (key: string) => table.columns.indexOf(key);
  const varied = table.columns
    .filter((key) => key.startsWith("/"))
    .map((key) => ({ key, at: at(key), ...parameter(schema, key) }));
  const figures = FIGURES.filter(({ key }) => at(key) >= 0).map((figure) => ({ ...figure, at: at(figure.key) }));
  return { varied, figures, seed: { key: "seed", at: at("seed"), title: "Seed" } };
}

/** The used part of a JSON Schema. */
export interface Schema {
  title?: string;
  "x-unit"?: string;
  properties?: Record<string, Schema>;
}

/** Title and unit of the parameter at a JSON pointer. Unknown parameters keep their names. */
export function parameter(schema: Schema | undefined, pointer: string): { title: string; unit?: string } {
  const segments = pointer.split("/").slice(1);
  let node = schema;
  for (const [depth, segment] of segments.entries()) {
    const next: Schema | undefined = node?.properties?.[segment];
    if (!next) return { title: [node?.title, ...segments.slice(depth)].filter(Boolean).join(" ") };
    node = next;
  }
  const title = node?.title ?? segments.at(-1) ?? pointer;
  return node?.["x-unit"] ? { title, unit: node["x-unit"] } : { title };
}

export interface Order {
  key: string;
  descending: boolean;
}

/** Reads an order such as `-summary.volume_mm3`, which means largest first. */
export function readOrder(text: string | null): Order | undefined {
  if (!text) return undefined;
  return text.startsWith("-") ? { key: text.slice(1), descending: true } : { key: text, descending: false };
}

export function writeOrder({ key, descending }: Order): string {
  return descending ? `-${key}` : key;
}

/** Rows in this order. Rows without a value are last in both directions. */
export function sorted(table: Table, order: Order | undefined): Table["rows"] {
  const at = order ? table.columns.indexOf(order.key) : -1;
  if (!order || at < 0) return table.rows;
  const sign = order.descending ? -1 : 1;
  return table.rows.toSorted((a, b) => {
    const [x, y] = [a[at] ?? null, b[at] ?? null];
    if (x === null || y === null) return Number(x === null) - Number(y === null);
    return sign * compare(x, y);
  });
}

function compare(x: NonNullable<Cell>, y: NonNullable<Cell>): number {
  if (typeof x === "number" && typeof y === "number") return x - y;
  return text(x).localeCompare(text(y), "en", { numeric: true });
}

export function text(cell: Cell | undefined): string {
  if (cell === null || cell === undefined) return "";
  return typeof cell === "object" ? JSON.stringify(cell) : String(cell);
}

/** Pairs of numeric values from two columns, with the id of the model. */
export function pairs(table: Table, x: Column, y: Column): { id: string; x: number; y: number }[] {
  const id = table.columns.indexOf("id");
  return table.rows.flatMap((row) => {
    const [a, b] = [row[x.at], row[y.at]];
    return typeof a === "number" && typeof b === "number" ? [{ id: text(row[id]), x: a, y: b }] : [];
  });
}

/** About `count` round numbers within a range. */
export function ticks(from: number, to: number, count: number): number[] {
  const rough = (to - from) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5, 10].find((factor) => factor * power >= rough) ?? 10);
  const first = Math.ceil(from / step);
  return Array.from({ length: Math.floor(to / step) - first + 1 }, (_, k) => Number(((first + k) * step).toPrecision(12)));
}
