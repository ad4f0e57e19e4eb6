// Actions on a model, as buttons.
import { useState } from "preact/hooks";
import { OviductError, type Model, type ModelRequest, type ModelState } from "oviduct-client";
import { hasEnded } from "../growing/words.ts";
import { forget, remember } from "../models.ts";
import { href } from "../router.ts";
import { ask, explain } from "../service.ts";
import { Icon, toast, type IconName } from "../ui/widgets.tsx";
import { Confirm } from "./confirm.tsx";
import "./model.css";

/** Runs an action; shows the error and returns undefined if it fails. */
export async function attempt<T>(what: () => Promise<T>): Promise<T | undefined> {
  try {
    return await what();
  } catch (error) {
    toast(explain(error), "error");
    return undefined;
  }
}

export async function cancel(id: string): Promise<void> {
  remember([await ask((service) => service.cancel(id))]);
}

export async function remove(id: string): Promise<void> {
  try {
    await ask((service) => service.delete(id));
  } catch (error) {
    // Another client has already deleted the model.
    if (!(error instanceof OviductError && error.is("model-not-found"))) throw error;
  }
  forget(id);
}

async function retry(id: string): Promise<Model> {
  const model = await ask((service) => service.retry(id));
  remember([model]);
  return model;
}

/** Submits the request of a model again; without a seed, the service draws one. */
async function again(id: string, seed?: number): Promise<Model> {
  const { preset, spec, outputs, bodies, units, labels, priority, backend } = await ask((service) => service.get(id));
  const request: ModelRequest = { preset, outputs, bodies, units, labels, priority, backend: backend.requested };
  if (spec) request.spec = spec;
  if (seed !== undefined) request.seed = seed;
  const model = await ask((service) => service.submit(request));
  remember([model]);
  return model;
}

interface Props {
  model: ModelState;
  /** Name of the model for the labels of buttons, on pages with several models. */
  name?: string;
  /** Called with the new model that was requested from this one. */
  onMade: (model: Model) => void;
  onDeleted?: () => void;
}

export function ModelActions({ model, name, onMade, onDeleted }: Props) {
  const [busy, setBusy] = useState(false);
  const [deleting, setDeleting] = useState(false);
  const { id, status, seed } = model;
  const run = async (what: () => Promise<Model | void>) => {
    setBusy(true);
    const made = await attempt(what);
    setBusy(false);
    if (made) onMade(made);
  };
  const of = name ? ` ${name}` : "";
  const button = (icon: IconName, text: string, what: () => Promise<Model | void>) => (
    <Action icon={icon} text={text} label={text + of} disabled={busy} compact={name !== undefined} onClick={() => run(what)} />
  );
  return (
    <div class="model-actions" role="group" aria-label={`Actions${of}`}>
      {!hasEnded(model) && button("stop", "Cancel", () => cancel(id))}
      {status === "failed" && button("retry", "Retry", () => retry(id))}
      {status === "cancelled" && button("retry", "Grow again", () => again(id, seed))}
      {button("dice", "Another seed", () => again(id))}
      <a class={name ? "button-icon" : "button"} href={href(["new"], { from: id })} title="Change the request" aria-label={`Change the request${of && ` of${of}`}`}>
        <Icon name="pencil" /> {!name && "Change"}
      </a>
      <Action icon="trash" text="Delete" label={`Delete${of}`} danger compact={name !== undefined} onClick={() => setDeleting(true)} />
      {deleting && (
        <Confirm title="Delete this model?" action="Delete" onConfirm={() => attempt(() => remove(id).then(onDeleted))} onClose={() => setDeleting(false)}>
          <p>
            {hasEnded(model) ? "The model and its files are removed." : "The model has not ended. It is cancelled and removed."} This
            cannot be undone.
          </p>
        </Confirm>
      )}
    </div>
  );
}

interface ActionProps {
  icon: IconName;
  text: string;
  label: string;
  compact: boolean;
  disabled?: boolean;
  danger?: boolean;
  onClick: () => void;
}

function Action({ icon, text, label, compact, disabled = false, danger = false, onClick }: ActionProps) {
  const kind = `${compact ? "button-icon" : "button"}${danger ? " button-danger" : ""}`;
  return (
    <button type="button" class={kind} title={compact ? text : undefined} aria-label={label} disabled={disabled} onClick={onClick}>
      <Icon name={icon} /> {!compact && text}
    </button>
  );
}
