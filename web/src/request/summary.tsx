// Summary next to the form: predicted cost, faults, and the button that sends the request.
import { workers } from "../growing/workers.tsx";
import { standstill } from "../growing/words.ts";
import { Notice } from "../ui/widgets.tsx";
import { checking, faults, opinion } from "./check.ts";
import { costOf } from "./cost.ts";
import { sentence } from "./faults.ts";
import { variedPointer } from "./form.ts";
import { controlId, goTo } from "./inputs.tsx";
import { form, localFaults, titles } from "./state.ts";
import { refusal, sending, submit } from "./submit.ts";

/** Focuses the first field with a fault. */
function goToFault(): void {
  const [first] = faults.value.keys();
  if (first !== undefined) goTo(first);
}

export function Summary() {
  const { purpose, backend } = form.value;
  const study = purpose === "study";
  const cost = costOf(opinion.value, backend, workers.value);
  const models = opinion.value?.kind === "study" ? opinion.value.validation.models : undefined;
  const number = [...faults.value.values()].flat().length;
  const idle = standstill(workers.value, backend);
  const stale = checking.value || localFaults() !== undefined;
  return (
    <aside class="card summary" aria-label="Cost and submission">
      <div class="summary-main">
        <div class={stale ? "stale" : undefined} role="status">
          <p class="headline">{number > 0 ? plural(number) : (cost?.headline ?? (opinion.value?.kind === "unknown" ? "Not checked" : "Checking …"))}</p>
          {cost && number === 0 && <p class="brief-cost small soft">{cost.brief}</p>}
        </div>
        <button type="button" class="button button-primary" aria-disabled={sending.value} onClick={send}>
          {sending.value ? "Sending …" : study ? `Grow ${models === undefined || stale ? "the models" : `${models} ${models === 1 ? "model" : "models"}`}` : "Grow the model"}
        </button>
      </div>
      {refusal.value !== undefined && <p class="refusal" role="alert">{refusal.value}</p>}
      {number > 0 && (
        <ul class="fault-list">
          {[...faults.value.keys()].map((pointer) => (
            <li key={pointer}>
              <button type="button" class="link" onClick={() => goTo(pointer)}>{titleOf(pointer)}</button>
            </li>
          ))}
        </ul>
      )}
      {opinion.value?.kind === "unknown" && !checking.value && <p class="soft small">The request could not be checked. {opinion.value.reason}</p>}
      {idle && (
        <div class="idle small">
          <strong>{idle.title}.</strong> {idle.detail}
        </div>
      )}
      {cost && number === 0 && (
        <dl class={`cost small ${stale ? "stale" : ""}`}>
          {cost.details.map(([term, value]) => (
            <div key={term}>
              <dt>{term}</dt>
              <dd class="num">{value}</dd>
            </div>
          ))}
        </dl>
      )}
    </aside>
  );
}

/** Faults that belong to no field. */
export function GeneralFaults() {
  const general = faults.value.get("");
  if (!general) return null;
  return (
    <div id={controlId("")} tabIndex={-1}>
      <Notice title="The request cannot be accepted as it is" kind="error">
        {general.map((fault) => (
          <p key={fault.detail}>{sentence(fault, "", "The request", titles.value)}</p>
        ))}
      </Notice>
    </div>
  );
}

/** Sends the form, or focuses the first fault. */
async function send(): Promise<void> {
  if (faults.value.size > 0 && !checking.value) goToFault();
  else if (!(await submit())) goToFault();
}

function plural(number: number): string {
  return number === 1 ? "One correction needed" : `${number} corrections needed`;
}

const TITLES: Record<string, string> = {
  "": "The whole request",
  "/preset": "Preset",
  "/seed": "Seed",
  "/seeds": "Seeds",
  "/count": "Models",
  "/labels": "Labels",
  "/outputs": "Files of the model",
  "/bodies": "Surfaces of",
  "/units": "Unit of lengths",
  "/backend": "Computed by",
  "/priority": "Priority",
  "/reuse": "If an equal model exists",
  "/vary/samples": "Points",
};

function titleOf(pointer: string): string {
  const varied = form.value.varied.find((varied) => pointer.startsWith(variedPointer(varied.pointer)));
  const spec = varied?.pointer ?? pointer.slice("/spec".length);
  return TITLES[pointer] ?? titles.value.get(spec) ?? pointer;
}
