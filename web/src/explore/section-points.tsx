// Points of the contours of a section, between which distances are measured exactly.
import type { Section } from "oviduct-client";
import { useId } from "preact/hooks";
import { nearest } from "./contours.ts";

/** A point of a contour as it is stored. */
export interface ContourPoint {
  contour: "inner" | "outer";
  index: number;
}

/** The point of either contour that is nearest to a position; micrometres. */
export function nearestPoint({ inner, outer }: Pick<Section, "inner" | "outer">, x: number, y: number): ContourPoint {
  const [a, b] = [nearest(inner, x, y), nearest(outer, x, y)];
  return a.distance <= b.distance ? { contour: "inner", index: a.index } : { contour: "outer", index: b.index };
}

/** Micrometres. */
export function positionOf(section: Pick<Section, "inner" | "outer">, { contour, index }: ContourPoint): { x: number; y: number } {
  const { x, y } = section[contour];
  return { x: x[index]!, y: y[index]! };
}

/** Micrometres. */
export function distanceOf(section: Pick<Section, "inner" | "outer">, a: ContourPoint, b: ContourPoint): number {
  const [from, to] = [positionOf(section, a), positionOf(section, b)];
  return Math.hypot(to.x - from.x, to.y - from.y);
}

interface Props {
  section: Section;
  points: readonly ContourPoint[];
  onChange: (points: readonly ContourPoint[]) => void;
}

/** Chooses both points with the keyboard: arrow keys go along a contour. */
export function ContourPointInputs({ section, points, onChange }: Props) {
  const start: ContourPoint = { contour: "inner", index: 0 };
  const [a = start, b = start] = points;
  return (
    <div class="contour-points">
      <PointInput name="A" section={section} point={a} onChange={(point) => onChange([point, b])} />
      <PointInput name="B" section={section} point={b} onChange={(point) => onChange([a, point])} />
    </div>
  );
}

function PointInput(props: { name: string; section: Section; point: ContourPoint; onChange: (point: ContourPoint) => void }) {
  const { name, section, point, onChange } = props;
  const [contour, index] = [useId(), useId()];
  const last = section[point.contour].x.length - 1;
  return (
    <div class="row small">
      <span>{name}</span>
      <label class="visually-hidden" for={contour}>Contour of {name}</label>
      <select id={contour} value={point.contour} onChange={(event) => onChange({ contour: event.currentTarget.value === "outer" ? "outer" : "inner", index: 0 })}>
        <option value="inner">mucosa</option>
        <option value="outer">outer wall</option>
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
