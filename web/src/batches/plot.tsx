// Plot of a measure against a varied value, the seed, or another measure.
import { useId } from "preact/hooks";
import type { Table } from "oviduct-client";
import { go, route, setQuery } from "../router.ts";
import { short } from "../ui/format.ts";
import { pairs, ticks, type Column } from "./columns.ts";

const [WIDTH, HEIGHT] = [640, 300];
const FRAME = { left: 64, right: 12, top: 12, bottom: 46 };

export function Plot({ table, xs, ys }: { table: Table; xs: Column[]; ys: Column[] }) {
  const { query } = route.value;
  const find = (all: Column[], key: string | null) => all.find((column) => column.key === key) ?? all[0];
  const [x, y] = [find(xs, query.get("x")), find(ys, query.get("y"))];
  const points = x && y ? pairs(table, x, y) : [];
  if (!x || !y || table.rows.length < 3) return null;
  const choose = (axis: "x" | "y", key: string) => {
    const next = new URLSearchParams(query);
    next.set(axis, key);
    setQuery(next);
  };
  return (
    <section class="card plot" aria-label="Plot">
      <div class="row">
        <Choice label="Plot" columns={ys} value={y.key} onChange={(key) => choose("y", key)} />
        <Choice label="against" columns={xs} value={x.key} onChange={(key) => choose("x", key)} />
      </div>
      {points.length === 0 ? <p class="soft">Points appear as models succeed, where both are numbers.</p> : <Scatter points={points} x={x} y={y} />}
    </section>
  );
}

function Choice({ label, columns, value, onChange }: { label: string; columns: Column[]; value: string; onChange: (key: string) => void }) {
  const id = useId();
  return (
    <>
      <label for={id}>{label}</label>
      <select id={id} value={value} onChange={(event) => onChange(event.currentTarget.value)}>
        {columns.map(({ key, title }) => <option key={key} value={key}>{title}</option>)}
      </select>
    </>
  );
}

function Scatter({ points, x, y }: { points: { id: string; x: number; y: number }[]; x: Column; y: Column }) {
  const across = scale(points.map((point) => point.x), FRAME.left, WIDTH - FRAME.right);
  const up = scale(points.map((point) => point.y), HEIGHT - FRAME.bottom, FRAME.top);
  const label = ({ title, unit }: Column) => (unit ? `${title}, ${unit}` : title);
  return (
    <svg viewBox={`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label={`${label(y)} against ${label(x)}, ${points.length} models; the table below has the numbers`}>
      {ticks(...across.range, 6).map((at) => (
        <g key={at}>
          <path class="plot-line" d={`M${across.of(at)} ${FRAME.top}V${HEIGHT - FRAME.bottom}`} />
          <text x={across.of(at)} y={HEIGHT - FRAME.bottom + 16} text-anchor="middle">{tick(at)}</text>
        </g>
      ))}
      {ticks(...up.range, 5).map((at) => (
        <g key={at}>
          <path class="plot-line" d={`M${FRAME.left} ${up.of(at)}H${WIDTH - FRAME.right}`} />
          <text x={FRAME.left - 6} y={up.of(at) + 4} text-anchor="end">{tick(at)}</text>
        </g>
      ))}
      <text x={(FRAME.left + WIDTH - FRAME.right) / 2} y={HEIGHT - 6} text-anchor="middle">{label(x)}</text>
      <text transform={`translate(14 ${(FRAME.top + HEIGHT - FRAME.bottom) / 2}) rotate(-90)`} text-anchor="middle">{label(y)}</text>
      {points.map((point) => (
        <circle key={point.id} cx={across.of(point.x)} cy={up.of(point.y)} r={5} onClick={() => go(["models", point.id])}>
          <title>{`${x.title} ${short(point.x)}, ${y.title} ${short(point.y)}`}</title>
        </circle>
      ))}
    </svg>
  );
}

/** Label of an axis mark. Values may differ only in the fourth digit, and seeds are long. */
function tick(value: number): string {
  const notation = Math.abs(value) < 1e6 ? "standard" : "scientific";
  return value.toLocaleString("en", { maximumSignificantDigits: 6, notation });
}

/** Maps values to pixels, with a margin on both sides. */
function scale(values: number[], from: number, to: number): { of: (value: number) => number; range: [number, number] } {
  const [least, most] = [Math.min(...values), Math.max(...values)];
  const margin = (most - least) * 0.06 || Math.abs(most) * 0.06 || 1;
  const [low, high] = [least - margin, most + margin];
  return { of: (value) => from + ((value - low) / (high - low)) * (to - from), range: [low, high] };
}
