// Pictures of models that the service draws. An image element cannot send the key, so they are fetched.
import type { PreviewOptions } from "oviduct-client";
import { ask, session } from "./service.ts";

/** Pictures that are kept; a list shows as many at most before its first ones are dropped. */
const KEPT = 300;
const pictures = new Map<string, Promise<string>>();

/** The address of a picture of a model that has succeeded; `size` is its longest side in pixels. */
export function picture(id: string, view: NonNullable<PreviewOptions["view"]>, size: number): Promise<string> {
  // Another key may see other models.
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
