// Shape at a position along the tube: a planar cut of the surface, or else the simulated section.
import type { Cut, RingKind, SectionJson } from "oviduct-client";
import { area, boundsOf, type Box, type Outline } from "./contours.ts";

/** A closed contour, micrometres. */
export interface Contour extends Outline {
  kind: RingKind;
  /** Area within the contour, including everything it surrounds, square micrometres. */
  area: number;
}

export interface CrossSection {
  source: "surface" | "simulation";
  /** Contours, each after the contours that surround it. */
  contours: readonly Contour[];
  /** Area including islands, square micrometres. */
  tissue: number;
  /** Area including pockets and excluding islands, square micrometres. */
  lumen: number;
}

export function ofCut({ rings, tissue_area_um2: tissue, lumen_area_um2: lumen }: Cut): CrossSection {
  const contours = rings.map(({ kind, area_um2, points }) => ({ kind, area: area_um2, ...outlineOf(points) }));
  return { source: "surface", contours, tissue, lumen };
}

export function ofSection({ inner, outer }: Pick<SectionJson, "inner" | "outer">): CrossSection {
  const [wall, mucosa] = [outlineOf(outer.points), outlineOf(inner.points)];
  const [whole, lumen] = [area(wall), area(mucosa)];
  const contours: Contour[] = [{ kind: "tissue", area: whole, ...wall }, { kind: "lumen", area: lumen, ...mucosa }];
  return { source: "simulation", contours, tissue: whole - lumen, lumen };
}

function outlineOf(points: readonly (readonly number[])[]): Outline {
  return { x: Float64Array.from(points, ([x]) => x!), y: Float64Array.from(points, ([, y]) => y!) };
}

/** Bounding box of all tissue. */
export function extentOf({ contours }: CrossSection): Box {
  const boxes = contours.filter(({ kind }) => kind === "tissue").map(boundsOf);
  return {
    x0: Math.min(...boxes.map(({ x0 }) => x0)),
    y0: Math.min(...boxes.map(({ y0 }) => y0)),
    x1: Math.max(...boxes.map(({ x1 }) => x1)),
    y1: Math.max(...boxes.map(({ y1 }) => y1)),
  };
}

export function areas({ contours }: CrossSection, wanted: RingKind): number[] {
  return contours.filter(({ kind }) => kind === wanted).map(({ area }) => area);
}

const NAMES: Record<RingKind, string> = { tissue: "outer wall", lumen: "mucosa", island: "island", pocket: "pocket" };

/** A name for each contour, such as `mucosa` or `island 2`. */
export function names({ contours }: CrossSection): string[] {
  const counts = new Map<RingKind, number>();
  const total = (wanted: RingKind) => contours.filter(({ kind }) => kind === wanted).length;
  return contours.map(({ kind }) => {
    const nth = (counts.get(kind) ?? 0) + 1;
    counts.set(kind, nth);
    const isAlone = (kind === "tissue" || kind === "lumen") && total(kind) === 1;
    return isAlone ? NAMES[kind] : `${NAMES[kind]} ${nth}`;
  });
}
