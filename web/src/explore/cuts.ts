// Planar cuts of the surface of a model.
import { OviductError, type Cut } from "oviduct-client";

/** A cut, or why there is none: in this plane, or in any. */
export type Answer = { cut: Cut } | { cut?: undefined; why: string; ever: boolean };

const REASONS = {
  "file-not-found": { why: "the model has no surface that can be cut", ever: true },
  "surface-too-large": { why: "the surface is too large to be cut by the service", ever: true },
  "cut-not-found": { why: "the plane does not meet the surface", ever: false },
} as const;

/** What a refusal means for the page; undefined for one that is an error. */
export function refusal(error: unknown): Answer | undefined {
  if (!(error instanceof OviductError)) return undefined;
  const slug = (Object.keys(REASONS) as (keyof typeof REASONS)[]).find((slug) => error.is(slug));
  return slug && REASONS[slug];
}

/** What the page makes of an answer; rejects with what is an error. */
export async function answered(answer: Promise<Cut>): Promise<Answer> {
  try {
    return { cut: await answer };
  } catch (error) {
    const instead = refusal(error);
    if (!instead) throw error;
    return instead;
  }
}

/** How far from the ends planes are, micrometres: they would touch the caps. */
const INSIDE = 0.5;

/** The place of the plane for a section: that of the section, but within the surface, which reaches from `low` to `high`. */
export function planeAt(z_um: number, low: number, high: number): number {
  return Math.max(low + INSIDE, Math.min(high - INSIDE, z_um));
}
