// One model of the list; follows changes of the model itself.
import type { ModelState } from "oviduct-client";
import { growth, placeInQueue } from "../growing/words.ts";
import { ModelActions } from "../model/actions.tsx";
import { Labels } from "../model/labels.tsx";
import { presetTitle } from "../model/presets.ts";
import { state } from "../models.ts";
import { href } from "../router.ts";
import { micrometres, short } from "../ui/format.ts";
import { Ago, ProgressBar, StatusBadge, toast } from "../ui/widgets.tsx";
import { Thumbnail } from "./thumbnail.tsx";
import { shortId } from "./twins.ts";

interface Props {
  id: string;
  selected: boolean;
  /** True if another row has the same preset and seed. */
  twin: boolean;
  /** Must be the same function in every render; otherwise every row is rendered with the list. */
  onSelect: (id: string, selected: boolean) => void;
}

export function Row({ id, selected, twin, onSelect }: Props) {
  const model = state(id).value;
  if (!model) return null;
  const title = presetTitle(model.preset);
  const seed = `seed ${model.seed}${twin ? `, ${shortId(id)}` : ""}`;
  const name = `${title}, ${seed}`;
  const target = href(["models", id]);
  return (
    <li class="model-row card" aria-label={name}>
      <input type="checkbox" checked={selected} aria-label={`Select ${name}`} onChange={(event) => onSelect(id, event.currentTarget.checked)} />
      <a href={target} tabIndex={-1} aria-hidden="true"><Thumbnail model={model} /></a>
      <div class="model-text">
        <h2>
          <a href={target}>{title} <span class="seed num">{seed}</span></a> <StatusBadge status={model.status} />
        </h2>
        <Doing model={model} name={name} />
        <div class="model-meta small soft">
          <Ago time={model.created_at} />
          {model.batch && <a href={href(["batches", model.batch])}>Study</a>}
          <Labels labels={model.labels} />
        </div>
      </div>
      <ModelActions model={model} name={name} onMade={({ seed }) => toast(`A model with seed ${seed} was requested.`)} />
    </li>
  );
}

function Doing({ model, name }: { model: ModelState; name: string }) {
  const { status, progress, queue, problem, summary } = model;
  if (status === "queued") return <p>{placeInQueue(queue)}</p>;
  if (status === "running") {
    return (
      <div class="model-progress">
        <ProgressBar fraction={progress?.fraction ?? 0} label={`Growth of ${name}`} />
        <span class="small num">{growth(progress)}</span>
      </div>
    );
  }
  if (status === "failed") return <p class="model-problem">{problem?.title ?? "Failed"}</p>;
  if (status === "cancelled" || !summary) return null;
  const gap = summary.min_gap_um;
  return (
    <p class="num">
      {short(summary.triangles)} triangles · {short(summary.volume_mm3)} mm³ of tissue
      {typeof gap === "number" && ` · smallest gap ${micrometres(gap)}`}
    </p>
  );
}
