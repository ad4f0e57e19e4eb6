// Pictures of models that the service draws. Image elements cannot send an API key, so `fetch`
// loads them.
import type { PreviewOptions } from "oviduct-client";
import { ask, session } from "./service.ts";

/**
 * Maximum number of kept pictures; also the maximum that a list shows without losing its first
 * ones.
 */
const KEPT = 300;
const pictures = new Map<string, Promise<string>>();

/** The URL of a succeeded model's picture; `size` is its longest side in pixels. */
export function picture(id: string, view: NonNullable<PreviewOptions["view"]>, size: number): Promise<string> {
  // Another API key may see other models.
  const name = [session.peek(), id, view, size].join(" ");
  let known = pictures.get(name);
  if (!known) {
    known = ask((service) => service.preview(id, { view, size })).then((png) =>
      URL.createObjectURL(new Blob([png], { type: "image/png" })),
    );
    known.catch(() => pictures.delete(name));
    pictures.set(name, known);
    dropOldest();
  }
  return known;
}

function dropOldest(): void {
  const [oldest] = pictures;
  if (pictures.size <= KEPT || !oldest) return;
  pictures.delete(oldest[0]);
  void oldest[1].then(URL.revokeObjectURL, () => {});
}
