// Options of a request besides its spec: preset, seed, labels, files, queueing.
import { Icon } from "../ui/widgets.tsx";
import { BACKENDS, BODIES, OUTPUTS, UNITS, type Backend, type Form } from "./form.ts";
import { controlId, controlOf, Faults, Field } from "./inputs.tsx";
import { catalogue, change, form, preset } from "./state.ts";

export function PresetChoice() {
  const { presets } = catalogue.value!;
  return (
    <fieldset class="presets" id={controlId("/preset")} tabIndex={-1}>
      <legend>Preset</legend>
      {presets.map(({ name, title, organ, species, description }) => (
        <label key={name} class="preset">
          <input type="radio" name="preset" checked={name === preset.value?.name} aria-describedby={`preset-${name}`} onChange={() => change({ preset: name })} />
          <span>
            <strong>{title}</strong> <span class="soft small">{organ}, {species}</span>
            <span class="hint" id={`preset-${name}`}>{description}</span>
          </span>
        </label>
      ))}
      <Faults pointer="/preset" title="The preset" />
    </fieldset>
  );
}

export function SeedField() {
  return (
    <Field pointer="/seed" title="Seed" hint="The same seed and parameters give the same model. Empty: the service draws one.">
      <span class="measure">
        <input {...controlOf("/seed")} inputMode="numeric" autocomplete="off" placeholder="drawn" value={form.value.seed} onInput={({ currentTarget }) => change({ seed: currentTarget.value })} />
        <button type="button" class="button-icon" aria-label="Draw a seed" title="Draw a seed" onClick={() => change({ seed: String(Math.floor(Math.random() * 1e6)) })}>
          <Icon name="dice" />
        </button>
      </span>
    </Field>
  );
}

export function MoreOptions() {
  const { outputs, bodies, units, backend, priority, reuse } = form.value;
  return (
    <div class="stack">
      <Labels />
      <div class="columns">
        <fieldset class="field" id={controlId("/outputs")} tabIndex={-1}>
          <legend>Files of the model</legend>
          <Boxes titles={OUTPUTS} chosen={outputs} set={(outputs) => change({ outputs })} />
          <Faults pointer="/outputs" title="The list of files" />
          <div class="hint">Cross sections and a report are always written.</div>
        </fieldset>
        <div class="stack">
          <fieldset class="field" id={controlId("/bodies")} tabIndex={-1}>
            <legend>Surfaces of</legend>
            <Boxes titles={BODIES} chosen={bodies} set={(bodies) => change({ bodies })} />
            <Faults pointer="/bodies" title="The list of bodies" />
          </fieldset>
          <Field pointer="/units" title="Unit of lengths" hint="glTF is always in metres; by default OBJ too, the others in millimetres.">
            <select {...controlOf("/units")} value={units} onChange={({ currentTarget }) => change({ units: currentTarget.value as Form["units"] })}>
              {entriesOf(UNITS).map(([name, title]) => (
                <option key={name} value={name}>{title}</option>
              ))}
            </select>
          </Field>
        </div>
        <Field pointer="/backend" title="Computed by">
          <select {...controlOf("/backend", false)} value={backend} onChange={({ currentTarget }) => change({ backend: currentTarget.value as Backend })}>
            {entriesOf(BACKENDS).map(([name, title]) => (
              <option key={name} value={name}>{title}</option>
            ))}
          </select>
        </Field>
        <Field pointer="/priority" title="Priority" hint="Of queued models, those of higher priority start first; 0 is usual.">
          <input {...controlOf("/priority")} inputMode="numeric" autocomplete="off" value={priority} onInput={({ currentTarget }) => change({ priority: currentTarget.value })} />
        </Field>
        <Field pointer="/reuse" title="If an equal model exists">
          <select {...controlOf("/reuse", false)} value={reuse ? "yes" : "no"} onChange={({ currentTarget }) => change({ reuse: currentTarget.value === "yes" })}>
            <option value="yes">Use it</option>
            <option value="no">Grow it again</option>
          </select>
        </Field>
      </div>
    </div>
  );
}

/** A checkbox per name; the chosen names keep the order of all names. */
function Boxes<Name extends string>({ titles, chosen, set }: { titles: Record<Name, string>; chosen: readonly Name[]; set: (chosen: readonly Name[]) => void }) {
  const all = entriesOf(titles);
  const toggle = (toggled: Name, wanted: boolean) =>
    set(all.map(([name]) => name).filter((name) => (name === toggled ? wanted : chosen.includes(name))));
  return (
    <>
      {all.map(([name, title]) => (
        <label key={name} class="row">
          <input type="checkbox" checked={chosen.includes(name)} onChange={({ currentTarget }) => toggle(name, currentTarget.checked)} /> {title}
        </label>
      ))}
    </>
  );
}

function Labels() {
  const { labels } = form.value;
  const set = (index: number, part: { name?: string; value?: string }) =>
    change({ labels: labels.map((label, i) => (i === index ? { ...label, ...part } : label)) });
  return (
    <fieldset class="field label-rows">
      <legend>Labels</legend>
      {labels.map(({ name, value }, i) => (
        <div key={i} class="row label-row">
          <input aria-label={`Name of label ${i + 1}`} placeholder="project" autocomplete="off" value={name} onInput={({ currentTarget }) => set(i, { name: currentTarget.value })} />
          <input aria-label={`Value of label ${i + 1}`} placeholder="demo" autocomplete="off" value={value} onInput={({ currentTarget }) => set(i, { value: currentTarget.value })} />
          <button type="button" class="button-icon" aria-label={`Remove label ${i + 1}`} onClick={() => change({ labels: labels.filter((_, other) => other !== i) })}>
            <Icon name="trash" />
          </button>
        </div>
      ))}
      <div>
        <button {...controlOf("/labels")} aria-invalid={undefined} type="button" class="button" onClick={() => change({ labels: [...labels, { name: "", value: "" }] })}>
          <Icon name="plus" /> Add a label
        </button>
      </div>
      <Faults pointer="/labels" title="The labels" />
      <div class="hint" id={`${controlId("/labels")}-hint`}>Names and values of your own, to find models by.</div>
    </fieldset>
  );
}

function entriesOf<Name extends string>(titles: Record<Name, string>): [Name, string][] {
  return Object.entries(titles) as [Name, string][];
}
