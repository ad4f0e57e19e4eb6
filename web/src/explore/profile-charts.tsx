// Measures along the tube.
import { useSignal, type Signal } from "@preact/signals";
import { useMemo } from "preact/hooks";
import { ticks } from "../batches/columns.ts";
import { short } from "../ui/format.ts";
import { nearestIndex } from "./ascending.ts";
import type { Exploration } from "./exploration.ts";
import type { Tube } from "./framing.ts";
import { extent, published, seriesOf, type Series } from "./series.ts";
import type { View } from "./view.ts";

export function ProfileCharts({ exploration, view }: { exploration: Exploration; view: View }) {
  const { report, reportFault } = exploration;
  const { morphometry, comparison } = report.value ?? {};
  const all = useMemo(() => (morphometry ? seriesOf(morphometry, comparison) : []), [morphometry]);
  if (all.length > 0) {
    const { from_mm, to_mm } = morphometry!.regions["junction"] ?? {};
    const junction = from_mm === undefined || to_mm === undefined ? undefined : ([from_mm, to_mm] as const);
    return <Charts all={all} junction={junction} exploration={exploration} view={view} />;
  }
  if (report.value) return <p class="soft">The version that grew this model did not measure it along the tube.</p>;
  return reportFault.value === undefined ? <p class="soft" aria-busy="true">Loading the measures …</p> : null;
}

interface ChartsProps {
  all: readonly Series[];
  /** Beginning and end of the junction between isthmus and ampulla, millimetres. */
  junction?: readonly [number, number] | undefined;
  exploration: Exploration;
  view: View;
}

function Charts({ all, junction, exploration: { model, tube }, view }: ChartsProps) {
  // Pointing at one chart shows the values at that position in all charts.
  const hovered = useSignal<number | undefined>(undefined);
  const { begin, length } = tube;
  const isWhole = begin === 0 && Math.abs(length - (model.spec?.length_mm ?? length)) < 1e-3;
  const towards = isWhole ? "" : "towards the ";
  const axis = <><span>{short(begin)} mm, {towards}isthmus</span><span>{short(begin + length)} mm, {towards}ampulla</span></>;
  const many = all.length > 4;
  return (
    <>
      <div class={`charts${many ? " charts-many" : ""}`}>
        {all.map((one) => (
          <Chart
            key={one.title}
            series={one}
            junction={junction}
            tube={tube}
            present={begin + view.section.value * length}
            hovered={hovered}
            onChoose={(z) => view.goTo((z - begin) / length)}
          />
        ))}
      </div>
      <div class={`chart-axes small soft num${many ? " charts-many" : ""}`}>
        <div class="chart-axis">{axis}</div>
        {/* Of the second column, if there is room for one. */}
        {many && <div class="chart-axis chart-axis-second" aria-hidden="true">{axis}</div>}
      </div>
      <p class="chart-legend small soft num">
        {all.some(({ bands }) => bands.length > 0) && <span><i class="chart-key chart-key-band" /> published range</span>}
        {junction && <span><i class="chart-key chart-key-rule" /> junction, {short(junction[0])} to {short(junction[1])} mm</span>}
      </p>
    </>
  );
}

interface ChartProps {
  series: Series;
  junction?: readonly [number, number] | undefined;
  tube: Tube;
  /** Position of the shown cross section, millimetres. */
  present: number;
  /** Position under the pointer, millimetres. */
  hovered: Signal<number | undefined>;
  onChoose: (z: number) => void;
}

const [WIDTH, HEIGHT] = [600, 100];

/**
 * A line over the length of the tube. Pointing at it shows a value, and clicking shows the
 * cross section.
 */
function Chart({ series, junction, tube, present, hovered, onChoose }: ChartProps) {
  const { title, unit, z, values } = series;
  const { x, y, scale, drawn } = useMemo(() => drawing(series, tube, junction), [series, tube]);
  const at = nearestIndex(z, hovered.value ?? present);
  const placeAt = (event: MouseEvent) => {
    const box = (event.currentTarget as Element).getBoundingClientRect();
    return z[nearestIndex(z, tube.begin + ((event.clientX - box.left) / box.width) * tube.length)]!;
  };
  const value = (k: number) => `${short(values[k]!)}${unit && ` ${unit}`}`;
  const ranges = published(series);
  const label = `${title} along the tube: ${value(0)} at the isthmus, ${value(values.length - 1)} at the ampulla`;
  return (
    <figure class="chart">
      <figcaption>
        {title}
        <output class="num">
          <strong>{value(at)}</strong> <span class="soft">at {short(z[at]!)} mm</span>
        </output>
      </figcaption>
      <div class="chart-frame">
        <div class="chart-ticks num" aria-hidden="true">
          {scale}
        </div>
        <svg
          viewBox={`0 0 ${WIDTH} ${HEIGHT}`}
          preserveAspectRatio="none"
          role="img"
          aria-label={ranges ? `${label}; ${ranges}` : label}
          onPointerMove={(event) => (hovered.value = placeAt(event))}
          onPointerLeave={() => (hovered.value = undefined)}
          onClick={(event) => onChoose(placeAt(event))}
        >
          {drawn}
          <line class="chart-marker" x1={x(z[at]!)} x2={x(z[at]!)} y1={0} y2={HEIGHT} />
          <line class="chart-level" x1={0} x2={WIDTH} y1={y(values[at]!)} y2={y(values[at]!)} />
        </svg>
      </div>
      {/* The picture is named so, too. */}
      {ranges && <p class="chart-published small num" aria-hidden="true">{ranges}</p>}
    </figure>
  );
}

/**
 * The constant parts of a chart, and functions from length and value to the picture.
 *
 * In a flight, charts are rendered several times per second; constant parts are then skipped.
 */
function drawing(series: Series, { begin, length }: Tube, junction: ChartProps["junction"]) {
  const { z, values, starts, bands } = series;
  const { bottom, top } = extent(series);
  const x = (at: number) => ((at - begin) / length) * WIDTH;
  const y = (value: number) => HEIGHT * (1 - (value - bottom) / (top - bottom));
  const runs = starts.map((start, k) => {
    const end = starts[k + 1] ?? z.length;
    const points = Array.from({ length: end - start }, (_, i) => `${x(z[start + i]!).toFixed(1)} ${y(values[start + i]!).toFixed(1)}`);
    // An isolated point is a line of length 0, whose round ends are visible.
    const line = `M${points.length > 1 ? points.join("L") : `${points[0]}L${points[0]}`}`;
    return { line, area: `${line}V${HEIGHT}H${x(z[start]!).toFixed(1)}Z` };
  });
  // An area means that the axis begins at 0, and it would hide ranges.
  const area = bottom === 0 && bands.length === 0 ? runs.map((run) => run.area).join("") : undefined;
  const marks = ticks(bottom, top, 5);
  const scale = (
    <>{marks.map((mark) => <span key={mark} style={{ top: `${(100 * y(mark)) / HEIGHT}%` }}>{short(mark)}</span>)}</>
  );
  const drawn = (
    <>
      {marks.map((mark) => <line key={mark} class="chart-grid" x1={0} x2={WIDTH} y1={y(mark)} y2={y(mark)} />)}
      {area && <path class="chart-area" d={area} />}
      {bands.map(({ from, to, low, high }, k) => (
        <rect key={k} class="chart-band" x={x(from)} width={x(to) - x(from)} y={y(high)} height={y(low) - y(high)} />
      ))}
      {junction?.map((at) => <line key={at} class="chart-rule" x1={x(at)} x2={x(at)} y1={0} y2={HEIGHT} />)}
      <path class="chart-line" d={runs.map((run) => run.line).join("")} />
    </>
  );
  return { x, y, scale, drawn };
}
