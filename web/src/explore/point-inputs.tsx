// Selects points of a cross section's contours without a pointer.
import { useId } from "preact/hooks";
import { names, type CrossSection } from "./cross-section.ts";
import type { ContourPoint } from "./section-points.ts";

interface Props {
  section: CrossSection;
  points: readonly ContourPoint[];
  onChange: (points: readonly ContourPoint[]) => void;
}

/** Selects both points with the keyboard: arrow keys move along a contour. */
export function ContourPointInputs({ section, points, onChange }: Props) {
  const lumen = section.contours.findIndex(({ kind }) => kind === "lumen");
  const start: ContourPoint = { contour: Math.max(0, lumen), index: 0 };
  const [a = start, b = start] = points;
  return (
    <div class="contour-points">
      <PointInput name="A" section={section} point={a} onChange={(point) => onChange([point, b])} />
      <PointInput name="B" section={section} point={b} onChange={(point) => onChange([a, point])} />
    </div>
  );
}

function PointInput(props: { name: string; section: CrossSection; point: ContourPoint; onChange: (point: ContourPoint) => void }) {
  const { name, section, point, onChange } = props;
  const [contour, index] = [useId(), useId()];
  const last = section.contours[point.contour]!.x.length - 1;
  return (
    <div class="row small">
      <span>{name}</span>
      <label class="visually-hidden" for={contour}>Contour of {name}</label>
      <select id={contour} value={point.contour} onChange={(event) => onChange({ contour: Number(event.currentTarget.value), index: 0 })}>
        {names(section).map((name, k) => (
          <option key={k} value={k}>{name}</option>
        ))}
      </select>
      <label for={index}>point</label>
      <input
        id={index}
        type="number"
        min={0}
        max={last}
        value={point.index}
        aria-label={`Point ${name}`}
        onInput={(event) => {
          const value = event.currentTarget.valueAsNumber;
          if (Number.isInteger(value) && value >= 0 && value <= last) onChange({ contour: point.contour, index: value });
        }}
      />
    </div>
  );
}
