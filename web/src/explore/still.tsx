// The service's picture of a model, in place of the 3D view.
import type { ComponentChildren } from "preact";
import { useEffect, useState } from "preact/hooks";
import { base, key } from "../service.ts";
import type { Exploration } from "./exploration.ts";

export function Still({ exploration, children }: { exploration: Exploration; children: ComponentChildren }) {
  const [url, setUrl] = useState<string>();
  useEffect(() => {
    const abort = new AbortController();
    let made: string | undefined;
    preview(exploration.model.id, abort.signal).then(
      (picture) => setUrl((made = URL.createObjectURL(picture))),
      // A service without pictures: the words remain.
      () => undefined,
    );
    return () => {
      abort.abort();
      if (made) URL.revokeObjectURL(made);
    };
  }, []);
  return (
    <div class="still">
      {url && <img src={url} alt={`The model ${exploration.model.seed}, opened`} />}
      <p>{children}</p>
    </div>
  );
}

/** An image element cannot send the key. */
async function preview(id: string, signal: AbortSignal): Promise<Blob> {
  const url = new URL(`models/${encodeURIComponent(id)}/preview.png?view=opened&size=1024`, base);
  const headers: Record<string, string> = key.peek() === undefined ? {} : { authorization: `Bearer ${key.peek()}` };
  const response = await fetch(url, { signal, headers });
  if (!response.ok) throw new Error(`no picture: ${response.status}`);
  return response.blob();
}
