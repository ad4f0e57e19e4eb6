// Models with the same preset and seed, which differ in other parameters.
import type { ModelState } from "oviduct-client";

/** Ids of the models that share preset and seed with another model. */
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

/** The last characters of an id, which differ even between models of the same moment. */
export function shortId(id: string): string {
  return id.slice(-6);
}
