// Properties of models in words.
import type { Report } from "oviduct-client";
import { short, squareMicrometres } from "../ui/format.ts";
import type { Course } from "./course.ts";

/** `no islands`, `1 island (1,730 µm²)`, `3 islands (5,210 µm²)`. */
export function census(areas: readonly number[], name: string): string {
  if (areas.length === 0) return `no ${name}s`;
  const sum = areas.reduce((a, b) => a + b, 0);
  return `${areas.length} ${name}${areas.length === 1 ? "" : "s"} (${squareMicrometres(sum)})`;
}

/** Summary of planar cuts in one line; undefined if the report has none. */
export function islands({ cuts }: Pick<Report, "cuts">): string | undefined {
  if (!cuts) return undefined;
  const { count, with_islands, islands_per_cut, island_area_um2: area } = cuts;
  const through = `${count} planar cuts through the ampulla`;
  if (islands_per_cut === 0) return `No islands in ${through}`;
  return `Islands in ${Math.round(100 * with_islands)} % of ${through}, ${islands_per_cut.toFixed(1)} a cut${area ? `, median ${squareMicrometres(area.p50)}` : ""}`;
}

/** Course of the whole tube in words, even if the model is a piece of it. */
export function courseInWords(course: Pick<Course, "tortuosity" | "endDistance" | "turned" | "isStraight"> | undefined): string {
  if (!course) return "The tube is straight.";
  const { tortuosity, endDistance, turned, isStraight } = course;
  if (isStraight) return `The tube is straight and turned by ${short(turned)}° about its centre line.`;
  return `The tube follows a centre line of tortuosity ${short(tortuosity)} with ends ${short(endDistance)} mm apart.`;
}
