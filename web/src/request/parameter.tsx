// A parameter of the spec: its value, its meaning, and the source of the preset's value.
import { short } from "../ui/format.ts";
import { Icon } from "../ui/widgets.tsx";
import { controlId, controlOf, Faults, Marked, NumberInput } from "./inputs.tsx";
import type { Bounds, Kind, Parameter } from "./parameters.ts";
import { isSchedule, type Value } from "./schedule.ts";
import { ScheduleField, summary } from "./scheduled.tsx";
import { form, setParameter } from "./state.ts";

export function ParameterField({ parameter }: { parameter: Parameter }) {
  const { pointer, title, description, unit, source, kind, preset } = parameter;
  const changed = form.value.changes[pointer];
  const id = controlId(`/spec${pointer}`);
  return (
    <div class={`field parameter ${changed === undefined ? "" : "parameter-changed"}`}>
      <div class="parameter-head">
        {kind.type === "schedule" ? <span class="parameter-title">{title}</span> : <label class="parameter-title" for={id}>{title}</label>}
        {changed !== undefined && (
          <button type="button" class="reset" aria-label={`Changed: reset ${title} to ${written(preset, unit)}`} title={`Preset: ${written(preset, unit)}`} onClick={() => setParameter(parameter, preset)}>
            <Icon name="retry" /> changed
          </button>
        )}
      </div>
      <Control parameter={parameter} value={changed ?? preset} onChange={(value) => setParameter(parameter, value)} />
      <Faults pointer={`/spec${pointer}`} title={title} />
      <div class="hint" id={`${id}-hint`}>
        <Marked text={description} />
      </div>
      <details class="source">
        <summary>Preset and source<span class="visually-hidden"> of {title}</span></summary>
        <dl>
          <dt>Preset</dt>
          <dd>{written(preset, unit)}</dd>
          {"bounds" in kind && (
            <>
              <dt>Allowed</dt>
              <dd>{range(kind.bounds, unit)}</dd>
            </>
          )}
          {source && (
            <>
              <dt>Source</dt>
              <dd>{source}</dd>
            </>
          )}
          <dt>Pointer</dt>
          <dd class="mono">{pointer}</dd>
        </dl>
      </details>
    </div>
  );
}

/** Names of the numbers of a point, by their count. */
const COORDINATES: Record<number, string> = { 2: "x, y", 3: "x, y, z", 4: "at, turn_deg, toward_deg, share" };

function Control({ parameter, value, onChange }: { parameter: Parameter; value: Value; onChange: (value: Value) => void }) {
  const { unit, kind } = parameter;
  const attributes = controlOf(`/spec${parameter.pointer}`);
  switch (kind.type) {
    case "schedule":
      return <ScheduleField parameter={{ ...parameter, kind }} value={isSchedule(value) ? value : Number(value)} onChange={onChange} />;
    case "number":
      return (
        <span class="measure">
          <NumberInput {...attributes} value={Number(value)} onValue={onChange} />
          <span class="unit">{unit}</span>
        </span>
      );
    case "choice":
      return <ChoiceSelect kind={kind} value={String(value)} onChange={onChange} attributes={attributes} />;
    case "points":
      return (
        <>
          <textarea {...attributes} class="mono" rows={5} autocomplete="off" spellcheck={false} value={String(value)} onInput={({ currentTarget }) => onChange(currentTarget.value)} />
          <span class="hint">One a line: {COORDINATES[kind.coordinates] ?? "a row of numbers"}{unit && ` in ${unit}`}</span>
        </>
      );
    case "flag":
      return (
        <span class="row">
          <input {...attributes} type="checkbox" checked={value === true} onChange={({ currentTarget }) => onChange(currentTarget.checked)} />
        </span>
      );
  }
}

function ChoiceSelect(props: { kind: Kind & { type: "choice" }; value: string; onChange: (value: string) => void; attributes: ReturnType<typeof controlOf> }) {
  const chosen = props.kind.choices.find(({ name }) => name === props.value);
  return (
    <>
      <select {...props.attributes} value={props.value} onChange={({ currentTarget }) => props.onChange(currentTarget.value)}>
        {props.kind.choices.map(({ name }) => (
          <option key={name} value={name}>{name}</option>
        ))}
      </select>
      {chosen?.description && <span class="hint"><Marked text={chosen.description} /></span>}
    </>
  );
}

function written(value: Value, unit: string): string {
  if (value === "") return "none";
  if (isSchedule(value)) return summary(value, unit);
  if (typeof value === "boolean") return value ? "yes" : "no";
  return `${value} ${unit}`.trim();
}

function range({ minimum, maximum, reason }: Bounds, unit: string): string {
  const ends =
    minimum === undefined ? `up to ${short(maximum ?? Infinity)}` : maximum === undefined ? `${short(minimum)} or more` : `${short(minimum)} to ${short(maximum)}`;
  return `${ends} ${unit}`.trim() + (reason ? `; ${reason}` : "");
}
