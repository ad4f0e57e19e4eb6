// Figures along the tube.
import { useSignal } from "@preact/signals";
import { useMemo } from "preact/hooks";
import { short } from "../ui/format.ts";
import { nearestIndex } from "./ascending.ts";
import type { Exploration } from "./exploration.ts";
import type { View } from "./view.ts";

/** A figure of every section. */
interface Series {
  title: string;
  unit: string;
  /** Millimetres from the isthmus end. */
  z: ArrayLike<number>;
  values: ArrayLike<number>;
}

export function ProfileCharts({ exploration, view }: { exploration: Exploration; view: View }) {
  const { survey, fractions, sectionsFault, tube } = exploration;
  if (sectionsFault.value !== undefined) return null;
  if (!survey.value) return <p class="soft" aria-busy="true">Measuring the sections …</p>;
  const { z, lumen, tissue, mucosa } = survey.value.profile;
  const series: Series[] = [
    { title: "Area of the lumen", unit: "mm²", z, values: lumen },
    { title: "Area of the tissue", unit: "mm²", z, values: tissue },
    { title: "Length of the mucosa in the section", unit: "mm", z, values: mucosa },
  ];
  const present = nearestIndex(fractions.value, view.section.value);
  return (
    <div class="charts">
      {series.map((one) => (
        <Chart key={one.title} series={one} length={tube.length} present={present} onChoose={(k) => (view.section.value = fractions.peek()[k]!)} />
      ))}
      <div class="chart-axis small soft num"><span>0 mm, isthmus</span><span>{short(tube.length)} mm, ampulla</span></div>
    </div>
  );
}

interface ChartProps {
  series: Series;
  /** Of the tube, millimetres. */
  length: number;
  /** Index of the section that is shown. */
  present: number;
  onChoose: (index: number) => void;
}

const [WIDTH, HEIGHT] = [600, 100];

/** A line over the length of the tube; pointing at it shows a value, clicking chooses the section. */
function Chart({ series: { title, unit, z, values }, length, present, onChoose }: ChartProps) {
  const hovered = useSignal<number | undefined>(undefined);
  const { path, top } = useMemo(() => {
    const top = Math.max(...Array.from(values), 0) * 1.05 || 1;
    const points = Array.from(values, (value, i) => `${((z[i]! / length) * WIDTH).toFixed(1)} ${(HEIGHT * (1 - value / top)).toFixed(1)}`);
    return { path: `M${points.join("L")}`, top };
  }, [values]);
  const at = hovered.value ?? present;
  const indexAt = (event: MouseEvent) => {
    const box = (event.currentTarget as Element).getBoundingClientRect();
    return nearestIndex(z, ((event.clientX - box.left) / box.width) * length);
  };
  const x = (z[at]! / length) * WIDTH;
  return (
    <figure class="chart">
      <figcaption>
        {title}
        <output class="num">
          <strong>{short(values[at]!)} {unit}</strong> <span class="soft">at {short(z[at]!)} mm</span>
        </output>
      </figcaption>
      <svg
        viewBox={`0 0 ${WIDTH} ${HEIGHT}`}
        preserveAspectRatio="none"
        role="img"
        aria-label={`${title} along the tube: ${short(values[0]!)} ${unit} at the isthmus, ${short(values[values.length - 1]!)} ${unit} at the ampulla`}
        onPointerMove={(event) => (hovered.value = indexAt(event))}
        onPointerLeave={() => (hovered.value = undefined)}
        onClick={(event) => onChoose(indexAt(event))}
      >
        <path class="chart-area" d={`${path}L${WIDTH} ${HEIGHT}L0 ${HEIGHT}Z`} />
        <path class="chart-line" d={path} />
        <line class="chart-marker" x1={x} x2={x} y1={0} y2={HEIGHT} />
        <line class="chart-level" x1={0} x2={WIDTH} y1={HEIGHT * (1 - values[at]! / top)} y2={HEIGHT * (1 - values[at]! / top)} />
      </svg>
    </figure>
  );
}
