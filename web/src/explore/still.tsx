// The service's picture of a model, instead of the 3D view.
import type { ComponentChildren } from "preact";
import { useEffect, useState } from "preact/hooks";
import { picture } from "../pictures.ts";
import type { Exploration } from "./exploration.ts";

export function Still({ exploration, children }: { exploration: Exploration; children: ComponentChildren }) {
  const [url, setUrl] = useState<string>();
  const { id, seed } = exploration.model;
  useEffect(() => {
    // Without the picture, only the text is shown.
    picture(id, "opened", 1024).then(setUrl, () => {});
  }, []);
  return (
    <div class="still">
      {url && <img src={url} alt={`The model ${seed}, opened`} />}
      <p>{children}</p>
    </div>
  );
}
