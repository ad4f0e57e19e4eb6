// A queued or growing model.
import { useState } from "preact/hooks";
import type { ModelState } from "oviduct-client";
import { sections } from "../models.ts";
import { duration, short } from "../ui/format.ts";
import { ProgressBar } from "../ui/widgets.tsx";
import { bounds } from "./contours.ts";
import { SectionDrawing } from "./section.tsx";
import { Stage, type Trouble } from "./stage.tsx";
import { placeInQueue, percent, STAGES } from "./words.ts";
import { WorkersNotice } from "./workers.tsx";
import "./growing.css";

const TROUBLES: Record<Trouble, string> = {
  unloaded: "that part of the page could not be loaded. Reload the page to try again.",
  missing: "WebGL2 is missing in this browser.",
  lost: "the browser took the graphics card away. It is shown again when the browser gives it back.",
};

/** `length` is the length of the whole tube, micrometres. */
export function Growing({ model, length }: { model: ModelState; length: number }) {
  const [trouble, setTrouble] = useState<Trouble>();
  if (model.status === "queued") return <Waiting model={model} />;
  const seen = sections(model.id).value;
  const last = seen.at(-1);
  return (
    <div class="growing">
      <Stages model={model} />
      {trouble && <p class="soft">The tube is not shown in 3D: {TROUBLES[trouble]}</p>}
      <div class={`growing-views${trouble ? " flat" : ""}`}>
        {(!trouble || trouble === "lost") && (
          <div class="card growing-tube" hidden={trouble === "lost"}>
            <Stage sections={seen} length={length} onTrouble={setTrouble} />
            {seen.length === 0 && <p class="growing-empty soft">The first section appears soon.</p>}
          </div>
        )}
        <section class="card growing-section" aria-label="Newest section">
          <h2>{last ? `Section at ${(last.z_um / 1000).toFixed(1)} mm` : "Section"}</h2>
          <div class="growing-drawing">
            {last?.inner && (
              <SectionDrawing
                inner={last.inner} outer={last.outer} scaleBar box={bounds(seen.map(({ outer }) => outer))}
                label={`Cross section ${short(last.z_um / 1000)} mm from the isthmus: tissue around the folded lumen`}
              />
            )}
          </div>
          <Figures model={model} />
        </section>
      </div>
    </div>
  );
}

function Waiting({ model }: { model: ModelState }) {
  return (
    <div class="growing">
      <WorkersNotice />
      <section class="card growing-waiting">
        <h2>{placeInQueue(model.queue)}</h2>
        <p class="soft">
          It starts as soon as a worker is free. Models of higher priority go first, and submitters take turns. You may close
          this page: the model grows without it.
        </p>
      </section>
    </div>
  );
}

function Stages({ model }: { model: ModelState }) {
  const { progress } = model;
  const reached = STAGES.findIndex(({ stage }) => stage === progress?.stage);
  const left = progress?.eta_seconds;
  return (
    <section class="card growing-stages" aria-label="Progress">
      <div class="row">
        <strong class="num">{progress ? percent(progress.fraction) : "Starting"}</strong>
        {typeof left === "number" && <span class="soft num">about {duration(Math.max(1, Math.round(left)))} left</span>}
        <span class="soft growing-meaning">{STAGES[reached]?.meaning}</span>
      </div>
      <ProgressBar fraction={progress?.fraction ?? 0} label="Growth of the model" />
      <ol>
        {STAGES.map(({ stage, name }, k) => (
          <li key={stage} class={k < reached ? "done" : undefined} aria-current={k === reached ? "step" : undefined}>{name}</li>
        ))}
      </ol>
      {/* Screen readers are told of a new stage, not of every step. */}
      <p class="visually-hidden" role="status">{STAGES[reached]?.name}</p>
    </section>
  );
}

function Figures({ model: { progress, attempts } }: { model: ModelState }) {
  if (!progress) return null;
  return (
    <dl class="growing-figures num">
      <div><dt>Step</dt><dd>{short(progress.step)} of {short(progress.steps)}</dd></div>
      <div><dt>Particles</dt><dd>{short(progress.particles)}</dd></div>
      <div><dt>Sections</dt><dd>{short(progress.sections)}</dd></div>
      {attempts > 1 && <div><dt>Attempt</dt><dd>{attempts}</dd></div>}
    </dl>
  );
}
