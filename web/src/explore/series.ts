// Values plotted along the tube: measures of a report and their published ranges.
import type { Report } from "oviduct-client";
import { short } from "../ui/format.ts";
import { quantity } from "./quantities.ts";

export type Morphometry = NonNullable<Report["morphometry"]>;
export type Comparison = NonNullable<Report["comparison"]>;

/** A measure along the tube. */
export interface Series {
  title: string;
  unit: string;
  /** Positions of the sections that have a value, millimetres from the isthmus end. */
  z: ArrayLike<number>;
  values: ArrayLike<number>;
  /**
   * Indices at which the line starts again, because the sections before have no value. The first is
   * 0.
   */
  starts: readonly number[];
  bands: readonly Band[];
}

/** Published range of a region. */
export interface Band {
  region: string;
  /** Millimetres from the isthmus end. */
  from: number;
  to: number;
  low: number;
  high: number;
}

/** Plotted quantities, in the order of the report page. */
const PLOTTED = [
  "folds_on_ring",
  "branching_order_mean",
  "lumen_area_mm2",
  "tissue_area_mm2",
  "outer_diameter_mm",
  "muscle_thickness_um",
  "free_lumen",
  "perimeter_ratio",
  "tissue_thickness_p50_um",
  "lumen_gap_p50_um",
  "fold_height_p50_um",
  "fractal_dimension",
] as const;

/** Quantities of rays and masks, of the shape tree and of layers, which have values only in some sections. */
const OF_DETAIL: ReadonlySet<string> = new Set(["tissue_thickness_p50_um", "lumen_gap_p50_um", "fractal_dimension"]);
const OF_TREES: ReadonlySet<string> = new Set(["branching_order_mean", "fold_height_p50_um"]);
const OF_LAYERS: ReadonlySet<string> = new Set(["muscle_thickness_um", "free_lumen"]);

/** The series of a model, without quantities that have no values. */
export function seriesOf(morphometry: Morphometry, comparison: Comparison | undefined): Series[] {
  const { along, settings } = morphometry;
  const places = along["z_mm"] ?? [];
  return PLOTTED.flatMap((name) => {
    const stride = strideOf(name, settings);
    const points = known(places, along[name] ?? [], stride ?? 1);
    return points.z.length > 0 ? [{ ...quantity(name), ...points, bands: bandsOf(name, morphometry, comparison) }] : [];
  });
}

/** Interval of sections at which a quantity is measured. */
function strideOf(name: string, settings: Morphometry["settings"]): number | undefined {
  if (OF_LAYERS.has(name)) return settings.layers_every;
  if (OF_TREES.has(name)) return settings.tree_every;
  return OF_DETAIL.has(name) ? settings.detail_every : 1;
}

type Points = Pick<Series, "starts"> & { z: number[]; values: number[] };

/** The known values. A line connects sections that are at most `stride` apart. */
export function known(places: readonly (number | null)[], all: readonly (number | null)[], stride: number): Points {
  const points = { z: [] as number[], values: [] as number[], starts: [] as number[] };
  let last = -Infinity;
  for (const [k, value] of all.entries()) {
    const z = places[k];
    if (value === null || z == null) continue;
    if (k - last > stride) points.starts.push(points.z.length);
    points.z.push(z);
    points.values.push(value);
    last = k;
  }
  return points;
}

/** Published ranges of a quantity that apply to a region of the tube. */
export function bandsOf(name: string, { regions }: Morphometry, comparison: Comparison | undefined): Band[] {
  return (comparison?.compared ?? []).flatMap(({ quantity, region, low, high }) => {
    const place = regions[region];
    if (quantity !== name || !place || low == null || high == null) return [];
    return [{ region, from: place.from_mm, to: place.to_mm, low, high }];
  });
}

/** Range of the value axis. It begins at 0 unless the values vary little, as dimensions do. */
export function extent({ values, bands }: Pick<Series, "values" | "bands">): { bottom: number; top: number } {
  let [low, high] = [Infinity, 0];
  for (const value of [...Array.from(values), ...bands.flatMap((band) => [band.low, band.high])]) {
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  const top = high * 1.06 || 1;
  return { bottom: low > 0.6 * top ? low - 0.3 * (top - low) : Math.min(low, 0), top };
}

const REGIONS: Record<string, string> = { isthmus: "in the isthmus", junction: "in the junction", ampulla: "in the ampulla", whole: "over the whole tube" };

/** `published 7.41 to 9.21 or 1 to 2 in the isthmus, 28.9 to 37.9 in the ampulla`, or empty. */
export function published({ bands, unit }: Pick<Series, "bands" | "unit">): string {
  const ranges = Array.from(new Set(bands.map(({ region }) => region)), (region) => {
    const own = bands.filter((band) => band.region === region);
    const texts = new Set(own.map(({ low, high }) => `${short(low)} to ${short(high)}`));
    return `${[...texts].join(" or ")}${unit && ` ${unit}`} ${REGIONS[region] ?? region}`;
  });
  return ranges.length > 0 ? `published ${ranges.join(", ")}` : "";
}
