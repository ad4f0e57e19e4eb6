// Models that their preset and seed do not tell apart: they differ in other parameters.
import type { ModelState } from "oviduct-client";

/** The ids of those that share preset and seed with another one. */
export function twins(models: readonly Pick<ModelState, "id" | "preset" | "seed">[]): Set<string> {
  const first = new Map<string, string>();
  const found = new Set<string>();
  for (const { id, preset, seed } of models) {
    const name = `${preset} ${seed}`;
    const other = first.get(name);
    if (other === undefined) first.set(name, id);
    else found.add(other).add(id);
  }
  return found;
}

/** The end of an id: it differs also between models of one moment. */
export function shortId(id: string): string {
  return id.slice(-6);
}
