// Outlines of growing tubes, kept in the tab across a reload, because the service sends each
// section only once.
import { known, sections, type Contour, type LiveSection } from "../models.ts";
import { evenly } from "./contours.ts";

const STORED = "oviduct-outlines";
/**
 * Maximum numbers of kept models, of sections per model, and of points per section.
 *
 * Together about 300 kB; a page may store 5 MB.
 */
const [MODELS, SECTIONS, POINTS] = [4, 150, 48];

/** The outer contours of growing models as text; empty if there are none. */
export function writeOutlines(): string {
  const growing = [...known()].filter(({ id, status }) => status === "running" && sections(id).peek().length > 0);
  if (growing.length === 0) return "";
  return JSON.stringify(growing.slice(0, MODELS).map(({ id }) => [id, spread(sections(id).peek()).map(stored)]));
}

/** Restores written outlines; ignores other text. */
export function readOutlines(text: string): void {
  try {
    for (const [id, outlines] of JSON.parse(text) as [string, Stored[]][]) {
      sections(id).value = outlines.map(([index, step, z_um, outer]) => ({ index, step, z_um, outer: Float32Array.from(outer) }));
    }
  } catch {
    // The tubes begin with their next sections.
  }
}

/** Restores the outlines from before a reload, and stores them when the page is left. */
export function keepOutlines(): void {
  try {
    readOutlines(sessionStorage.getItem(STORED) ?? "[]");
    // Remove the stored outlines, so that nothing remains after the API key is forgotten.
    sessionStorage.removeItem(STORED);
  } catch {
    // Storage is blocked.
  }
  addEventListener("pagehide", () => {
    const text = writeOutlines();
    try {
      if (text === "") sessionStorage.removeItem(STORED);
      else sessionStorage.setItem(STORED, text);
    } catch {
      // Storage is blocked or full.
    }
  });
}

/** Index, step, z, and x and y of the contour's points in whole micrometres. */
type Stored = [number, number, number, number[]];

function stored({ index, step, z_um, outer }: LiveSection): Stored {
  return [index, step, z_um, Array.from(thin(outer), Math.round)];
}

function thin(contour: Contour): Contour {
  return contour.length > 2 * POINTS ? evenly(contour, POINTS) : contour;
}

/** As many sections as may be kept, evenly chosen, including the first and the last. */
function spread(all: readonly LiveSection[]): LiveSection[] {
  const count = Math.min(SECTIONS, all.length);
  return Array.from({ length: count }, (_, k) => all[Math.round((k * (all.length - 1)) / Math.max(1, count - 1))]!);
}
