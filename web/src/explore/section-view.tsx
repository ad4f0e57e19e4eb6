// One cross section as it is stored: contours, scale, and distances between its points.
import { useSignal } from "@preact/signals";
import { OviductError, type Section, type Sections } from "oviduct-client";
import { useEffect, useMemo, useRef } from "preact/hooks";
import { ask, explain } from "../service.ts";
import { bytes, micrometres, short } from "../ui/format.ts";
import { Icon, Notice, toast } from "../ui/widgets.tsx";
import { nearestIndex } from "./ascending.ts";
import { area, pathData } from "./contours.ts";
import type { Exploration } from "./exploration.ts";
import { ContourPointInputs } from "./point-inputs.tsx";
import { distanceOf, nearestPoint, positionOf, type ContourPoint } from "./section-points.ts";
import { dragged, pointAt, windowOf, zoomed, type SectionWindow } from "./section-window.ts";
import type { View } from "./view.ts";
import { control } from "./viewer/controls.ts";

interface Props {
  exploration: Exploration;
  view: View;
}

export function SectionView({ exploration, view }: Props) {
  const { sections, sectionsFault, fractions, model } = exploration;
  if (sectionsFault.value !== undefined) {
    return (
      <Notice title="The sections could not be loaded" kind="error">
        <p>{sectionsFault.value}</p>
        <button type="button" class="button" onClick={() => exploration.loadSections()}>Try again</button>
      </Notice>
    );
  }
  if (!sections.value) {
    const size = model.files.find((file) => file.name === "sections.bin")?.bytes;
    return <p class="soft" aria-busy="true">Loading the sections{size === undefined ? "" : ` (${bytes(size)})`} …</p>;
  }
  const index = nearestIndex(fractions.value, view.section.value);
  return <Loaded exploration={exploration} view={view} sections={sections.value} index={index} />;
}

function Loaded({ exploration, view, sections, index }: Props & { sections: Sections; index: number }) {
  const section = useMemo(() => sections.section(index), [sections, index]);
  const choose = (k: number) => (view.section.value = exploration.fractions.peek()[Math.max(0, Math.min(sections.length - 1, k))]!);
  const z = `${short(section.z_um / 1000)} mm`;
  const cutHere = () => {
    view.flight.value = undefined;
    view.position.value = view.section.peek();
    view.across.value = true;
  };
  return (
    <>
      <div class="section-slider">
        <button type="button" class="button-icon" aria-label="Previous section" disabled={index === 0} onClick={() => choose(index - 1)}>‹</button>
        <input
          type="range"
          min={0}
          max={sections.length - 1}
          value={index}
          aria-label="Section"
          aria-valuetext={`${index + 1} of ${sections.length}, ${z} from the isthmus`}
          onInput={(event) => choose(Number(event.currentTarget.value))}
        />
        <button type="button" class="button-icon" aria-label="Next section" disabled={index === sections.length - 1} onClick={() => choose(index + 1)}>›</button>
      </div>
      <div class="section-ends small soft"><span>isthmus</span><span>ampulla</span></div>
      <Drawing section={section} />
      <dl class="figures num">
        <div><dt>Section</dt><dd>{index + 1} of {sections.length}{section.added ? ", added" : ""}</dd></div>
        <div><dt>z</dt><dd>{z}</dd></div>
        <div><dt>Step</dt><dd>{short(section.step)}</dd></div>
        <div><dt>Points of the mucosa</dt><dd>{short(section.innerPoints)}</dd></div>
        <div><dt>Points of the outer wall</dt><dd>{short(section.outerPoints)}</dd></div>
        <div><dt>Lumen</dt><dd>{short(area(section.inner) / 1e6)} mm²</dd></div>
      </dl>
      <div class="row">
        <button type="button" class="button" onClick={cutHere}><Icon name="cut" /> Cut the model here</button>
        {(["svg", "png"] as const).map((kind) => (
          <button key={kind} type="button" class="button" onClick={() => save(exploration.model.id, index, kind)}>
            <Icon name="download" /> {kind.toUpperCase()}
          </button>
        ))}
      </div>
    </>
  );
}

/** Longest side of a drawing as PNG, pixels. */
const PIXELS = 2048;

/** Links need a ticket of their own each time, so the address is asked for when it is wanted. */
async function save(id: string, index: number, kind: "svg" | "png"): Promise<void> {
  try {
    const url = await ask((service) => service.sectionUrl(id, index));
    const link = document.createElement("a");
    link.href = kind === "svg" ? url : await pngOf(url);
    link.download = `section-${index}.${kind}`;
    link.click();
    if (kind === "png") URL.revokeObjectURL(link.href);
  } catch (error) {
    toast(explain(error), "error");
  }
}

/** The address of a drawing as PNG. */
async function pngOf(drawing: string): Promise<string> {
  const response = await fetch(drawing);
  if (!response.ok) throw await OviductError.of(response);
  const svg = await response.text();
  const [width, height] = /viewBox="\S+ \S+ (\S+) (\S+)"/.exec(svg)!.slice(1).map(Number) as [number, number];
  const scale = PIXELS / Math.max(width, height);
  const canvas = document.createElement("canvas");
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const image = new Image();
  // Not all browsers draw an image without a size.
  const sized = svg.replace("<svg ", `<svg width="${canvas.width}" height="${canvas.height}" `);
  image.src = URL.createObjectURL(new Blob([sized], { type: "image/svg+xml" }));
  await image.decode();
  URL.revokeObjectURL(image.src);
  canvas.getContext("2d")!.drawImage(image, 0, 0);
  const png = await new Promise<Blob | null>((resolve) => canvas.toBlob(resolve));
  return URL.createObjectURL(png!);
}

const ZOOM = 1.4;

function Drawing({ section }: { section: Section }) {
  const svg = useRef<SVGSVGElement>(null);
  const paths = useMemo(() => ({ inner: pathData(section.inner), outer: pathData(section.outer) }), [section]);
  const whole = useMemo(() => windowOf(section.outer), [section]);
  /** Undefined for the whole section. */
  const shown = useSignal<SectionWindow | undefined>(undefined);
  const measuring = useSignal(false);
  const points = useSignal<readonly ContourPoint[]>([]);
  const { x, y, span } = shown.value ?? whole;
  const drawn = useRef(section);
  if (drawn.current !== section) {
    // Points are of one section.
    drawn.current = section;
    points.value = [];
  }
  const zoom = (factor: number, at: { x: number; y: number }) => {
    const next = zoomed(shown.peek() ?? whole, factor, at, whole);
    shown.value = next === whole ? undefined : next;
  };
  useEffect(() => {
    const abort = new AbortController();
    const element = svg.current!;
    const side = () => element.getBoundingClientRect().width;
    const at = (right: number, down: number) => pointAt(shown.peek() ?? whole, right, down, side());
    const drag = (right: number, down: number) => (shown.value = dragged(shown.peek() ?? whole, right, down, side()));
    const tap = (right: number, down: number) => {
      if (!measuring.peek()) return;
      const { x, y } = at(right, down);
      const point = nearestPoint(section, x, y);
      points.value = points.peek().length === 1 ? [points.peek()[0]!, point] : [point];
    };
    control(element, { turn: drag, pan: drag, zoom: (factor, right, down) => zoom(factor, at(right, down)), tap }, abort.signal);
    return () => abort.abort();
  }, [section]);
  const bar = scaleBar(span);
  const ends = points.value.map((point) => positionOf(section, point));
  const [a, b] = ends;
  return (
    <figure class="drawing">
      <div class="drawing-sheet">
        <svg
          ref={svg}
          viewBox={`${x - span / 2} ${-y - span / 2} ${span} ${span}`}
          role="img"
          aria-label={`Cross section at ${short(section.z_um / 1000)} mm`}
          class={measuring.value ? "measuring" : undefined}
        >
          <g transform="scale(1 -1)">
            <path class="tissue" d={paths.outer} />
            <path class="lumen" d={paths.inner} />
            {a && b && <line class="distance" x1={a.x} y1={a.y} x2={b.x} y2={b.y} />}
            {ends.map((end, i) => (
              <circle key={i} class="distance-end" cx={end.x} cy={end.y} r={span * 0.008} />
            ))}
          </g>
        </svg>
        <div class="scale small num" style={{ width: `${(bar / span) * 100}%` }}>{micrometres(bar)}</div>
        <div class="drawing-tools">
          <button type="button" class="button-icon" aria-label="Zoom in" onClick={() => zoom(1 / ZOOM, { x, y })}>+</button>
          <button type="button" class="button-icon" aria-label="Zoom out" disabled={!shown.value} onClick={() => zoom(ZOOM, { x, y })}>−</button>
          <button type="button" class="button-icon" aria-label="Show the whole section" disabled={!shown.value} onClick={() => (shown.value = undefined)}>
            <Icon name="reset" />
          </button>
          <button type="button" class="button-icon" aria-label="Measure in the section" aria-pressed={measuring.value} onClick={() => (measuring.value = !measuring.value)}>
            <Icon name="ruler" />
          </button>
        </div>
      </div>
      {measuring.value && (
        <figcaption class="measure-caption">
          <p class="soft small">Click near a contour, or choose two of its points.</p>
          <ContourPointInputs section={section} points={points.value} onChange={(next) => (points.value = next)} />
          <p role="status" class="measured num">
            {points.value.length === 2 && (
              <>Distance <strong data-um={distanceOf(section, points.value[0]!, points.value[1]!)}>{micrometres(distanceOf(section, points.value[0]!, points.value[1]!))}</strong></>
            )}
          </p>
        </figcaption>
      )}
    </figure>
  );
}

/** A round length of about a fifth of the drawing, micrometres. */
function scaleBar(span: number): number {
  const power = 10 ** Math.floor(Math.log10(span / 4));
  return [5, 2, 1].map((factor) => factor * power).find((length) => length <= span / 4)!;
}
