// Measures along the tube, computed from the sections of a model.
import type { Sections } from "oviduct-client";
import { area, perimeter } from "./contours.ts";

/** Measures of all sections, isthmus end first. */
export interface Profile {
  /** Millimetres from the isthmus end. */
  z: Float64Array;
  /** Square millimetres. */
  lumen: Float64Array;
  /** Square millimetres. */
  tissue: Float64Array;
  /** Length of the mucosa in the section, millimetres. */
  mucosa: Float64Array;
}

/** Milliseconds of work between two pauses, so that the page stays responsive. */
const WORK = 12;

/**
 * Reads all sections in portions.
 *
 * @throws `signal.reason` if the signal is aborted.
 */
export async function survey(sections: Sections, signal: AbortSignal): Promise<Profile> {
  const count = sections.length;
  const figures = () => new Float64Array(count);
  const [z, lumen, tissue, mucosa] = [figures(), figures(), figures(), figures()];
  const pause = pauses(signal);
  for (let k = 0; k < count; k++) {
    const { inner, outer, z_um } = sections.section(k);
    z[k] = z_um / 1000;
    lumen[k] = area(inner) / 1e6;
    tissue[k] = area(outer) / 1e6 - lumen[k]!;
    mucosa[k] = perimeter(inner) / 1000;
    await pause();
  }
  return { z, lumen, tissue, mucosa };
}

/** Returns a function that pauses from time to time, so that the page can do other work. */
function pauses(signal: AbortSignal): () => Promise<void> {
  let started = performance.now();
  return async () => {
    if (performance.now() - started < WORK) return;
    await new Promise((resolve) => setTimeout(resolve));
    signal.throwIfAborted();
    started = performance.now();
  };
}
