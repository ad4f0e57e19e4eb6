// The outlines of growing tubes, kept in the tab while the page is loaded again: the service sends a section only once.
import { known, sections, type Contour, type LiveSection } from "../models.ts";
import { evenly } from "./contours.ts";

const STORED = "oviduct-outlines";
/** What is kept: the newest models, sections of each, points of each section. Some 300 kB, of the 5 MB that a page has. */
const [MODELS, SECTIONS, POINTS] = [4, 150, 48];

/** The outer contours of the models that grow, as text; empty if there is none. */
export function writeOutlines(): string {
  const growing = [...known()].filter(({ id, status }) => status === "running" && sections(id).peek().length > 0);
  if (growing.length === 0) return "";
  return JSON.stringify(growing.slice(0, MODELS).map(({ id }) => [id, spread(sections(id).peek()).map(stored)]));
}

/** Takes over what was written; text that is none of this is left alone. */
export function readOutlines(text: string): void {
  try {
    for (const [id, outlines] of JSON.parse(text) as [string, Stored[]][]) {
      sections(id).value = outlines.map(([index, step, z_um, outer]) => ({ index, step, z_um, outer: Float32Array.from(outer) }));
    }
  } catch {
    // The tubes begin with their next sections.
  }
}

/** Goes on with the outlines from before the page was loaded again, and keeps them when it is left. */
export function keepOutlines(): void {
  try {
    readOutlines(sessionStorage.getItem(STORED) ?? "[]");
    // The page has them now: a key that is forgotten leaves none behind.
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

/** Index, step, z, and x and y of the points of the contour; whole micrometres. */
type Stored = [number, number, number, number[]];

function stored({ index, step, z_um, outer }: LiveSection): Stored {
  return [index, step, z_um, Array.from(thin(outer), Math.round)];
}

function thin(contour: Contour): Contour {
  return contour.length > 2 * POINTS ? evenly(contour, POINTS) : contour;
}

/** As many sections as are kept, evenly chosen, with the first and the last. */
function spread(all: readonly LiveSection[]): LiveSection[] {
  const count = Math.min(SECTIONS, all.length);
  return Array.from({ length: count }, (_, k) => all[Math.round((k * (all.length - 1)) / Math.max(1, count - 1))]!);
}
