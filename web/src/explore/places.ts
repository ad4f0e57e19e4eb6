// Places of the simulated sections of a model.
import type { Report, Sections } from "oviduct-client";

/** One element per section, from the isthmus end. */
export interface Places {
  z_mm: readonly number[];
  /** Time steps; fractional for sections that were added to mend a slab. */
  step: readonly number[];
}

type Measured = Pick<Report, "simulated" | "morphometry" | "summary">;

/**
 * The places that a report lists; undefined if it does not list every section.
 *
 * Reports of old versions list none, and no report lists sections that were added.
 */
export function placesOf({ simulated, morphometry, summary }: Measured): Places | undefined {
  // The sections of a surface that does not lean are its cuts.
  const along = (simulated ?? morphometry)?.along;
  const [z_mm, step] = [known(along?.["z_mm"]), known(along?.["step"])];
  if (!z_mm || step?.length !== z_mm.length) return undefined;
  return z_mm.length === summary.sections && !summary.sections_added ? { z_mm, step } : undefined;
}

function known(values: readonly (number | null)[] | undefined): number[] | undefined {
  return values?.every((value) => value !== null) ? (values as number[]) : undefined;
}

/** The places in the file of all sections. */
export function placesIn({ entries }: Pick<Sections, "entries">): Places {
  return { z_mm: entries.map(({ z_um }) => z_um / 1000), step: entries.map(({ step }) => step) };
}
