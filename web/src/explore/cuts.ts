// Planar cuts of the surface of a model.
import { OviductError, type Cut } from "oviduct-client";

/** A cut, or the reason why there is none: in this plane, or in any plane (`ever`). */
export type Answer = { cut: Cut } | { cut?: undefined; why: string; ever: boolean };

/** Why there is no cut at a place; `fault` is an error after which a retry may succeed. */
export interface Lack {
  why: string;
  fault: boolean;
}

const REASONS = {
  "file-not-found": { why: "the model has no surface that can be cut", ever: true },
  "surface-too-large": { why: "the surface is too large to be cut by the service", ever: true },
  "cut-not-found": { why: "the plane does not meet the surface", ever: false },
} as const;

/** The meaning of a refusal; undefined if it is an error. */
export function refusal(error: unknown): Answer | undefined {
  if (!(error instanceof OviductError)) return undefined;
  const slug = (Object.keys(REASONS) as (keyof typeof REASONS)[]).find((slug) => error.is(slug));
  return slug && REASONS[slug];
}

/** Result of a request for a cut; rejects with errors. */
export async function answered(answer: Promise<Cut>): Promise<Answer> {
  try {
    return { cut: await answer };
  } catch (error) {
    const instead = refusal(error);
    if (!instead) throw error;
    return instead;
  }
}

/** Minimum distance of planes from the ends, micrometres, so that they do not touch the caps. */
const INSIDE = 0.5;

/** Position of the plane for a section, limited to the surface between `low` and `high`. */
export function planeAt(z_um: number, low: number, high: number): number {
  return Math.max(low + INSIDE, Math.min(high - INSIDE, z_um));
}
