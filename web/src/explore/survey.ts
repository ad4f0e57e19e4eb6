// Results computed from the sections of a model: measures along the tube, and a path through the
// lumen.
import type { Sections } from "oviduct-client";
import { centreline, type Centreline } from "./centreline.ts";
import { area, perimeter } from "./contours.ts";
import { DistanceField } from "./lumen.ts";

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

export interface Survey {
  profile: Profile;
  way: Centreline;
}

/** Maximum number of sections for the path. More sections do not make it smoother. */
const WAY_SECTIONS = 400;
/** Milliseconds of work between two pauses, so that the page stays responsive. */
const WORK = 12;

/**
 * Reads all sections in portions; the path through them starts at `begin` millimetres.
 *
 * @throws `signal.reason` if the signal is aborted.
 */
export async function survey(sections: Sections, begin: number, signal: AbortSignal): Promise<Survey> {
  const count = sections.length;
  const figures = () => new Float64Array(count);
  const [z, lumen, tissue, mucosa] = [figures(), figures(), figures(), figures()];
  const stride = Math.ceil(count / WAY_SECTIONS);
  const fields: DistanceField[] = [];
  const fieldsAt: number[] = [];
  const pause = pauses(signal);
  for (let k = 0; k < count; k++) {
    const { inner, outer, z_um } = sections.section(k);
    z[k] = z_um / 1000;
    lumen[k] = area(inner) / 1e6;
    tissue[k] = area(outer) / 1e6 - lumen[k]!;
    mucosa[k] = perimeter(inner) / 1000;
    if (k % stride === 0 || k === count - 1) {
      fields.push(new DistanceField(inner));
      fieldsAt.push(z_um - 1000 * begin);
    }
    await pause();
  }
  return { profile: { z, lumen, tissue, mucosa }, way: await centreline(fields, fieldsAt, pause) };
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
