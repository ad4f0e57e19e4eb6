// A value that may change along the tube: a constant, or a curve with its keys as numbers.
import { useRef, useState } from "preact/hooks";
import { Icon } from "../ui/widgets.tsx";
import { short } from "../ui/format.ts";
import { faults } from "./check.ts";
import { capital } from "./faults.ts";
import { CurveEditor, Sparkline } from "./curve.tsx";
import { controlOf, NumberInput, Segments } from "./inputs.tsx";
import type { Parameter, ScheduleKind } from "./parameters.ts";
import { addKey, isSchedule, removeKey, round, setKey, stepOf, valueAt, type Schedule, type Value } from "./schedule.ts";
import { form, parameters } from "./state.ts";

interface Props {
  parameter: Parameter & { kind: ScheduleKind };
  value: number | Schedule;
  onChange: (value: Value) => void;
}

export function ScheduleField({ parameter, value, onChange }: Props) {
  const { pointer, title, unit } = parameter;
  const [open, setOpen] = useState(false);
  // Keep the curve while the user tries a constant.
  const curve = useRef<Schedule | undefined>(undefined);
  if (isSchedule(value)) curve.current = value;
  const preset = parameter.preset as number | Schedule;
  const choose = (mode: "constant" | "curve") => {
    if (mode === "constant") {
      const middle = valueAt(value, 0.5);
      onChange(isSchedule(preset) ? Number(middle.toPrecision(3)) : preset);
      return;
    }
    const level = isSchedule(value) || Number.isNaN(value) ? 0 : value;
    onChange(curve.current ?? (isSchedule(preset) ? preset : { keys: [[0, level], [1, level]], ease: "linear" }));
    setOpen(true);
  };
  return (
    <>
      <div class="scheduled">
        <Segments
          label={`${title}: constant or along the tube`}
          value={isSchedule(value) ? "curve" : "constant"}
          choices={[["constant", "Constant"], ["curve", "Along the tube"]]}
          onChange={choose}
        />
        {isSchedule(value) ? (
          <button {...controlOf(`/spec${pointer}`)} type="button" class="button curve-button" aria-expanded={open} onClick={() => setOpen(!open)}>
            <Sparkline schedule={value} ghost={preset} />
            <span>{summary(value, unit)}</span>
            <span class="visually-hidden">: curve of {title}</span>
            <span class="chevron" aria-hidden="true" />
          </button>
        ) : (
          <span class="measure">
            <NumberInput {...controlOf(`/spec${pointer}`)} aria-label={title} value={value} onValue={onChange} />
            <span class="unit">{unit}</span>
          </span>
        )}
      </div>
      {isSchedule(value) && open && <Editor parameter={parameter} schedule={value} onChange={onChange} />}
    </>
  );
}

/** First and last value: `60 → 36 µm`. */
export function summary({ keys, fluctuation }: Schedule, unit: string): string {
  const number = (value: number) => (Number.isNaN(value) ? "?" : short(value));
  const swing = fluctuation ? ` ± ${number(fluctuation.amplitude)}` : "";
  return `${number(keys[0]![1])} → ${number(keys.at(-1)![1])}${swing} ${unit}`;
}

function Editor({ parameter, schedule, onChange }: { parameter: Props["parameter"]; schedule: Schedule; onChange: (value: Schedule) => void }) {
  const { pointer, title, unit, kind } = parameter;
  const preset = parameter.preset as number | Schedule;
  const faulty = new Set(faults.value.get(`/spec${pointer}`)?.map((fault) => fault.pointer));
  const at = `/spec${pointer}`;
  const wave = schedule.fluctuation;
  const setWave = (part: Partial<NonNullable<typeof wave>>) => onChange({ ...schedule, fluctuation: { amplitude: NaN, period: NaN, ...wave, ...part } });
  const addInWidestGap = () => {
    const gaps = schedule.keys.slice(1).map(([u], i) => [u - schedule.keys[i]![0], (u + schedule.keys[i]![0]) / 2] as const);
    const [, middle] = gaps.reduce((widest, gap) => (gap[0] > widest[0] ? gap : widest));
    const added = addKey(schedule, middle, stepOf(Math.abs(valueAt(schedule, middle)) / 100));
    if (added) onChange(added.schedule);
  };
  return (
    <div class="editor">
      <CurveEditor
        title={title}
        unit={unit}
        schedule={schedule}
        ghost={preset}
        bounds={kind.bounds}
        mostKeys={kind.mostKeys}
        nameOf={placeName}
        onChange={onChange}
      />
      <p class="hint">
        Drag a key or move it with the arrow keys, with Shift in fine steps. Enter adds a key, Delete removes it. Dashed: the
        preset.
      </p>
      <ol class="keys">
        {schedule.keys.map(([u, value], i) => {
          const end = i === 0 || i === schedule.keys.length - 1;
          return (
            <li key={i}>
              <span class="soft num" aria-hidden="true">{i + 1}</span>
              <label>
                <span>Fraction of steps</span>
                <NumberInput
                  value={u}
                  readOnly={end}
                  aria-label={`Key ${i + 1} of ${title}: fraction of the steps`}
                  aria-invalid={faulty.has(`${at}/keys/${i}/0`) || faulty.has(`${at}/keys/${i}`)}
                  onValue={(u) => onChange(setKey(schedule, i, [u, value]))}
                />
              </label>
              <label>
                <span>Value{unit && `, ${unit}`}</span>
                <NumberInput
                  value={value}
                  aria-label={`Key ${i + 1} of ${title}: value`}
                  aria-invalid={faulty.has(`${at}/keys/${i}/1`) || faulty.has(`${at}/keys/${i}`)}
                  onValue={(value) => onChange(setKey(schedule, i, [u, value]))}
                />
              </label>
              <button type="button" class="button-icon" disabled={end} aria-label={`Remove key ${i + 1} of ${title}`} onClick={() => onChange(removeKey(schedule, i))}>
                <Icon name="trash" />
              </button>
            </li>
          );
        })}
      </ol>
      <div class="row editor-options">
        <button type="button" class="button" disabled={schedule.keys.length >= kind.mostKeys} onClick={addInWidestGap}>
          <Icon name="plus" /> Add a key
        </button>
        <label class="row">
          Between keys
          <select value={schedule.ease} onChange={({ currentTarget }) => onChange({ ...schedule, ease: currentTarget.value })}>
            {kind.eases.map(({ name, description }) => (
              <option key={name} value={name} title={description}>{capital(name)}</option>
            ))}
          </select>
        </label>
        {kind.amplitude.maximum !== 0 && (
          <label class="row">
            <input
              type="checkbox"
              checked={wave !== undefined}
              onChange={({ currentTarget }) =>
                onChange({ ...schedule, fluctuation: currentTarget.checked ? firstWave(parameter, schedule) : undefined })
              }
            />
            Fluctuates
          </label>
        )}
        {wave && (
          <>
            <label class="row">
              by ±
              <NumberInput class="brief" value={wave.amplitude} aria-label={`Amplitude of the fluctuation of ${title}`} aria-invalid={faulty.has(`${at}/fluctuation/amplitude`)} onValue={(amplitude) => setWave({ amplitude })} />
              {unit}
            </label>
            <label class="row">
              every
              <NumberInput class="brief" value={wave.period} aria-label={`Period of the fluctuation of ${title}`} aria-invalid={faulty.has(`${at}/fluctuation/period`)} onValue={(period) => setWave({ period })} />
              steps
            </label>
          </>
        )}
      </div>
    </div>
  );
}

/** Initial fluctuation: a tenth of the value, ten periods along the tube, within the bounds. */
function firstWave({ kind }: Props["parameter"], schedule: Schedule): Schedule["fluctuation"] {
  const swing = Math.abs(valueAt(schedule, 0.5)) / 10 || 0.1;
  const steps = Number(current("/steps")) || 1000;
  return {
    amplitude: Number(Math.min(swing, kind.amplitude.maximum ?? Infinity).toPrecision(2)),
    period: Math.max(kind.period.minimum ?? 0, round(steps / 10, 1)),
  };
}

function current(pointer: string): Value | undefined {
  return form.value.changes[pointer] ?? parameters.value.find((parameter) => parameter.pointer === pointer)?.preset;
}

/**
 * Place along the tube at a fraction of the steps, from the spec's length and `z`.
 *
 * The fraction itself if these are faulty.
 */
function placeName(u: number): string {
  const [length, z] = [current("/length_mm"), current("/z")];
  const place = typeof length === "number" && length > 0 && z !== undefined && isSchedule(z) ? valueAt(z, u) * length : NaN;
  return Number.isFinite(place) ? `${short(place)} mm` : `${short(100 * u)} %`;
}
