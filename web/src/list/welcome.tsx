// Introduction for new users.
import { useState } from "preact/hooks";
import { attempt } from "../model/actions.tsx";
import { remember } from "../models.ts";
import { go, href } from "../router.ts";
import { ask } from "../service.ts";

export function Welcome() {
  const [busy, setBusy] = useState(false);
  const grow = async () => {
    setBusy(true);
    const model = await attempt(() => ask((service) => service.submit()));
    setBusy(false);
    if (!model) return;
    remember([model]);
    go(["models", model.id]);
  };
  return (
    <section class="welcome card">
      <img src="./icon.svg" alt="" />
      <h2>Grow your first model</h2>
      <p>
        This service grows 3D models of oviducts: a simulation folds the lining of the tube, section by section, from isthmus to
        ampulla. Each model becomes a closed surface, tested to be free of faults, to explore here or to download.
      </p>
      <p class="row">
        <button type="button" class="button button-primary" disabled={busy} onClick={grow}>Grow an oviduct</button>
        <a class="button" href={href(["new"], { purpose: "model" })}>Set the parameters</a>
      </p>
    </section>
  );
}
