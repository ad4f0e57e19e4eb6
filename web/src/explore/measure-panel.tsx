// Distance between two points of the surface, picked in the picture or typed.
import type { Signal } from "@preact/signals";
import { micrometres } from "../ui/format.ts";
import { Icon } from "../ui/widgets.tsx";
import { Panel } from "./controls.tsx";
import type { Measurement, Spot } from "./measure.ts";

export function MeasurePanel({ measurement, middle }: { measurement: Measurement; middle: Spot }) {
  const { picking, a, b, distance } = measurement;
  return (
    <Panel title="Measure a distance">
      <div class="row">
        <button type="button" class="button" aria-pressed={picking.value} onClick={() => (picking.value = !picking.value)}>
          <Icon name="ruler" /> Pick two points
        </button>
        {(a.value ?? b.value) && (
          <button type="button" class="button" onClick={() => measurement.clear()}>Clear</button>
        )}
      </div>
      {picking.value && <p class="soft small">Click or tap the surface, or a cut face: {a.value && !b.value ? "the second point." : "the first point."}</p>}
      <details class="small">
        <summary>Enter coordinates</summary>
        <Coordinates name="A" spot={a} start={middle} />
        <Coordinates name="B" spot={b} start={middle} />
      </details>
      <p role="status" class="measured num">{distance.value !== undefined && <>Distance <strong>{micrometres(distance.value)}</strong></>}</p>
    </Panel>
  );
}

/** Three numbers in millimetres. The first typed number creates a point from `start`. */
function Coordinates({ name, spot, start }: { name: string; spot: Signal<Spot | undefined>; start: Spot }) {
  const change = (axis: keyof Spot, text: string) => {
    const value = Number(text);
    if (text !== "" && Number.isFinite(value)) spot.value = { ...(spot.peek() ?? start), [axis]: value };
  };
  return (
    <div class="coordinates" role="group" aria-label={`Point ${name}`}>
      <span>{name}</span>
      {(["x", "y", "z"] as const).map((axis) => (
        <input
          key={axis}
          type="number"
          step={0.01}
          placeholder={axis}
          aria-label={`${name} ${axis}, mm`}
          value={spot.value ? Math.round(spot.value[axis] * 1e4) / 1e4 : ""}
          onChange={(event) => change(axis, event.currentTarget.value)}
        />
      ))}
      <span class="soft">mm</span>
    </div>
  );
}
