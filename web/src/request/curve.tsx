// The curve of a schedule, whose keys can be dragged or moved by the keyboard.
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { short } from "../ui/format.ts";
import type { Bounds } from "./parameters.ts";
import { addKey, curve, extent, moveKey, removeKey, round, stepOf, valueAt, type Schedule } from "./schedule.ts";

const HEIGHT = 220;
const MARGIN = { left: 56, right: 20, top: 14, bottom: 44 };
/** Width in pixels below which some labels are omitted. */
const NARROW = 460;
/** Step of the arrow keys along the tube; a tenth with Shift. */
const ALONG = 0.01;

interface Scale {
  x: (u: number) => number;
  y: (value: number) => number;
  u: (x: number) => number;
  value: (y: number) => number;
  ticks: number[];
  step: number;
}

/** The value range of the plot: both curves with room to drag, within the bounds. */
function span(schedule: Schedule, ghost: number | Schedule, { minimum, maximum }: Bounds): [number, number] {
  const [a, b] = [extent(schedule), extent(ghost)];
  const [low, high] = [Math.min(a[0], b[0]), Math.max(a[1], b[1])];
  const room = 0.3 * (high - low) || 0.3 * Math.abs(high) || 1;
  // A faulty value may be out of bounds.
  return [Math.min(low, Math.max(low - room, minimum ?? -Infinity)), Math.max(high, Math.min(high + room, maximum ?? Infinity))];
}

function scaleOf([low, high]: [number, number], width: number): Scale {
  const [w, h] = [width - MARGIN.left - MARGIN.right, HEIGHT - MARGIN.top - MARGIN.bottom];
  const range = high - low || 1;
  const tick = stepOf(range / 3);
  const first = Math.ceil(low / tick);
  return {
    x: (u) => MARGIN.left + u * w,
    y: (value) => MARGIN.top + ((high - value) / range) * h,
    u: (x) => (x - MARGIN.left) / w,
    value: (y) => high - ((y - MARGIN.top) / h) * range,
    ticks: Array.from({ length: Math.floor(high / tick) - first + 1 }, (_, i) => round((first + i) * tick, tick / 100)),
    step: stepOf(range / 100),
  };
}

function pathOf(points: readonly (readonly [number, number])[], { x, y }: Scale): string {
  return points.map(([u, v], i) => `${i === 0 ? "M" : "L"}${x(u).toFixed(1)} ${y(v).toFixed(1)}`).join("");
}

/** Width of an element in pixels. */
function useWidth() {
  const ref = useRef<HTMLDivElement>(null);
  const [width, setWidth] = useState(0);
  useLayoutEffect(() => {
    const observer = new ResizeObserver(([entry]) => setWidth(Math.round(entry!.contentRect.width)));
    observer.observe(ref.current!);
    return () => observer.disconnect();
  }, []);
  return { ref, width };
}

export interface CurveProps {
  title: string;
  unit: string;
  schedule: Schedule;
  /** The schedule of the preset. */
  ghost: number | Schedule;
  bounds: Bounds;
  mostKeys: number;
  /** Names the place along the tube at a fraction of the steps. */
  nameOf: (u: number) => string;
  onChange: (schedule: Schedule) => void;
}

export function CurveEditor(props: CurveProps) {
  const { title, unit, schedule, ghost, bounds, onChange } = props;
  const { ref, width } = useWidth();
  // The scale stays while a key is held; otherwise the key would move away from the pointer.
  const [held, setHeld] = useState<{ index: number; scale: Scale }>();
  const [wanted, setWanted] = useState<number>();
  useEffect(() => {
    if (wanted === undefined) return;
    ref.current?.querySelectorAll<SVGElement>("[role=slider]")[wanted]?.focus();
    setWanted(undefined);
  }, [wanted]);

  const scale = held?.scale ?? scaleOf(span(schedule, ghost, bounds), width);
  const { x, y, step } = scale;
  const move = (index: number, u: number, value: number, to = step) =>
    onChange(moveKey(schedule, index, [u, round(value, to)], bounds));
  const add = (u: number) => {
    const added = schedule.keys.length < props.mostKeys ? addKey(schedule, u, step) : undefined;
    if (!added) return;
    onChange(added.schedule);
    setWanted(added.index);
  };
  const placeOf = (event: PointerEvent | MouseEvent, { u, value }: Scale) => {
    const box = ref.current!.getBoundingClientRect();
    return [u(event.clientX - box.left), value(event.clientY - box.top)] as const;
  };
  const press = (event: KeyboardEvent, index: number) => {
    const [u, value] = schedule.keys[index]!;
    const fine = event.shiftKey ? 0.1 : 1;
    const along = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    const up = { ArrowDown: -1, ArrowUp: 1, PageDown: -10, PageUp: 10 }[event.key];
    if (along !== undefined) move(index, u + along * ALONG * fine, value, step * 0.1);
    else if (up !== undefined) move(index, u, value + up * step * fine, step * fine);
    else if (event.key === "Delete" || event.key === "Backspace") {
      onChange(removeKey(schedule, index));
      setWanted(Math.max(0, index - 1));
    } else if (event.key === "Enter" || event.key === "+") {
      const at = Math.min(index, schedule.keys.length - 2);
      add((schedule.keys[at]![0] + schedule.keys[at + 1]![0]) / 2);
    } else return;
    event.preventDefault();
  };

  const swing = schedule.fluctuation?.amplitude || 0;
  const points = curve(schedule);
  const band = swing > 0 ? [...points.map(([u, v]) => [u, v + swing] as const), ...points.toReversed().map(([u, v]) => [u, v - swing] as const)] : [];
  const drawn = schedule.keys.every(([u, v]) => Number.isFinite(u) && Number.isFinite(v));
  const right = width - MARGIN.right;
  const bottom = HEIGHT - MARGIN.bottom;
  return (
    <div class="curve" ref={ref}>
      {width > 0 && (
        <svg width={width} height={HEIGHT} role="group" aria-label={`Curve of ${title} along the tube`} onDblClick={(event) => add(placeOf(event, scale)[0])}>
          {scale.ticks.map((tick) => (
            <g key={tick} class="tick">
              <line x1={MARGIN.left} x2={right} y1={y(tick)} y2={y(tick)} />
              <text x={MARGIN.left - 8} y={y(tick)} dy="0.35em" text-anchor="end">{short(tick)}</text>
            </g>
          ))}
          {(width < NARROW ? [0, 0.5, 1] : [0, 0.25, 0.5, 0.75, 1]).map((u) => (
            <g key={u} class="tick">
              <line x1={x(u)} x2={x(u)} y1={MARGIN.top} y2={bottom} />
              <text x={x(u)} y={bottom + 16} text-anchor={u === 0 ? "start" : u === 1 ? "end" : "middle"}>
                {props.nameOf(u)}
              </text>
            </g>
          ))}
          <text class="end" x={x(0)} y={bottom + 36}>Isthmus</text>
          <text class="end" x={x(1)} y={bottom + 36} text-anchor="end">Ampulla</text>
          <path class="ghost" d={pathOf(curve(ghost), scale)} />
          {drawn && band.length > 0 && <path class="band" d={`${pathOf(band, scale)}Z`} />}
          {drawn && <path class="line" d={pathOf(points, scale)} />}
          {drawn &&
            schedule.keys.map(([u, value], index) => (
              <g
                key={index}
                class="key"
                tabindex={0}
                role="slider"
                aria-label={`${title}, key ${index + 1} of ${schedule.keys.length}`}
                aria-orientation="vertical"
                aria-valuenow={value}
                aria-valuemin={bounds.minimum}
                aria-valuemax={bounds.maximum}
                aria-valuetext={`${short(value)} ${unit} at ${props.nameOf(u)}`}
                transform={`translate(${x(u).toFixed(1)} ${y(value).toFixed(1)})`}
                onKeyDown={(event) => press(event, index)}
                onDblClick={(event) => event.stopPropagation()}
                onPointerDown={(event) => {
                  event.currentTarget.setPointerCapture(event.pointerId);
                  setHeld({ index, scale });
                }}
                onPointerMove={(event) => {
                  if (held?.index === index) move(index, ...placeOf(event, held.scale));
                }}
                onPointerUp={() => setHeld(undefined)}
                onPointerCancel={() => setHeld(undefined)}
              >
                <circle class="reach" r="20" />
                <circle class="dot-key" r="6.5" />
              </g>
            ))}
        </svg>
      )}
    </div>
  );
}

/** The curve in the size of a word, over the curve of the preset. */
export function Sparkline({ schedule, ghost }: { schedule: number | Schedule; ghost: number | Schedule }) {
  const [a, b] = [extent(schedule), extent(ghost)];
  const [low, high] = [Math.min(a[0], b[0]), Math.max(a[1], b[1])];
  const y = (v: number) => (high > low ? 3 + ((high - v) / (high - low)) * 22 : 14);
  const path = (value: number | Schedule) => curve(value).map(([u, v], i) => `${i === 0 ? "M" : "L"}${2 + u * 76} ${y(v)}`).join("");
  if (![low, high, valueAt(schedule, 0.5)].every(Number.isFinite)) return null;
  return (
    <svg class="sparkline" width="80" height="28" aria-hidden="true">
      <path class="ghost" d={path(ghost)} />
      <path class="line" d={path(schedule)} />
    </svg>
  );
}
