// One model: queued, growing, ended; a succeeded model is explored.
import type { FunctionComponent } from "preact";
import { useEffect, useState } from "preact/hooks";
import { OviductError, type Model, type ModelState } from "oviduct-client";
import { Growing } from "../growing/growing.tsx";
import { remember, state } from "../models.ts";
import { go, href, link, route } from "../router.ts";
import { ask, explain } from "../service.ts";
import { reconnections } from "../stream.ts";
import { Ago, CopyButton, Notice, StatusBadge, toast, Unloaded } from "../ui/widgets.tsx";
import { ModelActions } from "./actions.tsx";
import { Ended } from "./ended.tsx";
import { Labels } from "./labels.tsx";
import { presetTitle, usePresets } from "./presets.ts";
import "./model.css";

export default function ModelPage() {
  const [id] = useState(() => route.peek().path[1]!);
  const [read, setRead] = useState<Model>();
  const [fault, setFault] = useState<unknown>();
  const [attempts, setAttempts] = useState(0);
  const live = state(id).value;
  const succeeded = live?.status === "succeeded";

  // Events contain no spec, and there are none for models that ended before the page was opened.
  useEffect(() => {
    const abort = new AbortController();
    ask((service) => service.get(id, { signal: abort.signal })).then(
      (model) => {
        remember([model]);
        setRead(model);
        setFault(undefined);
      },
      (error: unknown) => abort.signal.aborted || setFault(error),
    );
    return () => abort.abort();
  }, [id, reconnections.value, succeeded, attempts]);

  usePresets();
  const model = live ?? undefined;
  const title = model && presetTitle(model.preset);
  useEffect(() => {
    if (title) document.title = `${title}, seed ${model!.seed} · oviduct`;
  }, [title]);

  if (fault instanceof OviductError && fault.is("model-not-found")) return <Missing detail="It never existed, or it was deleted." />;
  if (read && !model) return <Missing detail="It was deleted." />;
  // Only a response after the end contains the files.
  if (!model || !read || (succeeded && read.status !== "succeeded")) {
    return fault ? <Unread fault={fault} onRetry={() => setAttempts(attempts + 1)} /> : <p class="soft" aria-busy="true">Loading …</p>;
  }
  return (
    <>
      <Head model={model} title={title!} />
      <Body model={model} read={read} />
    </>
  );
}

function Head({ model, title }: { model: ModelState; title: string }) {
  const { backend, labels, batch, retry_of: retried, reused_from: reused } = model;
  return (
    <div class="model-head">
      <div>
        <h1>
          {title} <span class="seed num">seed {model.seed}</span> <StatusBadge status={model.status} />
        </h1>
        <div class="model-facts small soft">
          <Ago time={model.created_at} />
          {backend.used && <span title={backend.fallback ?? undefined}>{backend.device ?? backend.used}</span>}
          {batch && <a href={href(["batches", batch])}>Part of a study</a>}
          {retried && <a href={href(["models", retried])}>Retry of a failed model</a>}
          {reused && <a href={href(["models", reused])}>Files of an equal model</a>}
          <Labels labels={labels} />
        </div>
      </div>
      <div>
        <ModelActions model={model} onMade={({ id }) => go(["models", id])} onDeleted={() => (go([]), toast("The model was deleted."))} />
        <CopyButton label="Copy link" text={link} />
      </div>
    </div>
  );
}

function Body({ model, read }: { model: ModelState; read: Model }) {
  if (model.status === "succeeded") return <Explored model={read} />;
  if (model.status === "failed" || model.status === "cancelled") return <Ended model={model} />;
  return <Growing model={model} length={lengthOf(read)} />;
}

/** Length of the tube, micrometres. */
function lengthOf({ spec }: Model): number {
  return (spec?.length_mm ?? 60) * 1000;
}

type Explorer = FunctionComponent<{ model: Model }>;

/** The model in 3D; the code is loaded when the first model is shown. */
function Explored({ model }: { model: Model }) {
  const [explorer, setExplorer] = useState<{ Explore: Explorer } | "unavailable">();
  useEffect(() => {
    import("../explore/explore.tsx").then(
      ({ default: Explore }) => setExplorer({ Explore }),
      () => setExplorer("unavailable"),
    );
  }, []);
  if (explorer === "unavailable") return <Unloaded title="The 3D view could not be loaded" />;
  return explorer ? <explorer.Explore model={model} /> : <p class="soft" aria-busy="true">Loading …</p>;
}

function Missing({ detail }: { detail: string }) {
  return (
    <Notice title="There is no such model">
      <p>{detail}</p>
      <p><a href={href([])}>Go to the models</a></p>
    </Notice>
  );
}

function Unread({ fault, onRetry }: { fault: unknown; onRetry: () => void }) {
  return (
    <Notice title="The model could not be loaded" kind="error">
      <p>{explain(fault)}</p>
      <p class="row"><button type="button" class="button button-primary" onClick={onRetry}>Try again</button></p>
    </Notice>
  );
}
