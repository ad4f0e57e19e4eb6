// Drawing of a cross section: contours or a picture, scale, and distances between contour points.
import { useSignal } from "@preact/signals";
import type { ComponentChildren } from "preact";
import { useEffect, useId, useMemo, useRef } from "preact/hooks";
import { micrometres } from "../ui/format.ts";
import { Icon } from "../ui/widgets.tsx";
import { pathData } from "./contours.ts";
import { extentOf, type CrossSection } from "./cross-section.ts";
import { ContourPointInputs } from "./point-inputs.tsx";
import { distanceOf, nearestPoint, positionOf, type ContourPoint } from "./section-points.ts";
import { dragged, pointAt, windowOf, zoomed, type SectionWindow } from "./section-window.ts";
import type { Look, Picture } from "./slides.ts";
import { control } from "./viewer/controls.ts";

interface Props {
  section: CrossSection;
  /** Position along the tube, for the name of the drawing. */
  z: string;
  look: Look;
  /** Name of the picture; another name needs another picture. */
  name: string;
  waiting: boolean;
  picture: Picture | undefined;
  /** Called with the number of pixels of the whole section in each direction, as shown. */
  onPixels: (pixels: number) => void;
  /** Content on the sheet. */
  note: ComponentChildren;
  /** Content below the sheet. */
  children: ComponentChildren;
}

const ZOOM = 1.4;

export function Drawing({ section, z, look, name, waiting, picture, note, onPixels, children }: Props) {
  const svg = useRef<SVGSVGElement>(null);
  const clip = useId();
  const paths = useMemo(() => section.contours.map((contour) => ({ kind: contour.kind, data: pathData(contour) })), [section]);
  const whole = useMemo(() => windowOf(extentOf(section)), [section]);
  /** Shown part; undefined for the whole section. */
  const shown = useSignal<SectionWindow | undefined>(undefined);
  const measuring = useSignal(false);
  const points = useSignal<readonly ContourPoint[]>([]);
  const { x, y, span } = shown.value ?? whole;
  const drawn = useRef({ section, whole });
  if (drawn.current.section !== section) {
    // Points belong to one section.
    drawn.current = { section, whole };
    points.value = [];
  }
  const zoom = (factor: number, at: { x: number; y: number }) => {
    const { whole } = drawn.current;
    const next = zoomed(shown.peek() ?? whole, factor, at, whole);
    shown.value = next === whole ? undefined : next;
  };
  useEffect(() => {
    const abort = new AbortController();
    const element = svg.current!;
    const side = () => element.getBoundingClientRect().width;
    const present = () => shown.peek() ?? drawn.current.whole;
    const at = (right: number, down: number) => pointAt(present(), right, down, side());
    const drag = (right: number, down: number) => (shown.value = dragged(present(), right, down, side()));
    const tap = (right: number, down: number) => {
      if (!measuring.peek()) return;
      const { x, y } = at(right, down);
      const point = nearestPoint(drawn.current.section.contours, x, y);
      points.value = points.peek().length === 1 ? [points.peek()[0]!, point] : [point];
    };
    control(element, { turn: drag, pan: drag, zoom: (factor, right, down) => zoom(factor, at(right, down)), tap }, abort.signal);
    return () => abort.abort();
  }, []);
  const scale = whole.span / span;
  useEffect(() => onPixels(svg.current!.getBoundingClientRect().width * devicePixelRatio * scale), [name, waiting, scale]);
  const bar = scaleBar(span);
  const ends = points.value.map((point) => positionOf(section.contours, point));
  const [a, b] = ends;
  const distance = points.value.length === 2 ? distanceOf(section.contours, points.value[0]!, points.value[1]!) : undefined;
  return (
    <figure class="drawing contours">
      <div class={`drawing-sheet${look === "stained" ? " drawing-glass" : ""}`}>
        <svg
          ref={svg}
          viewBox={`${x - span / 2} ${-y - span / 2} ${span} ${span}`}
          role="img"
          aria-label={`Cross section at ${z}`}
          class={measuring.value ? "measuring" : undefined}
        >
          <g transform="scale(1 -1)">
            <g class={picture ? "under" : undefined}>{paths.map(({ kind, data }, k) => <path key={k} class={kind} d={data} />)}</g>
            {picture && (
              <>
                {/* The margin of a picture has a scale bar of its own. */}
                <clipPath id={clip}>
                  {paths.filter(({ kind }) => kind === "tissue").map(({ data }, k) => <path key={k} d={data} />)}
                </clipPath>
                <g clip-path={`url(#${clip})`}>
                  <image
                    href={picture.url}
                    x={whole.x - picture.width / 2}
                    y={-whole.y - picture.height / 2}
                    width={picture.width}
                    height={picture.height}
                    preserveAspectRatio="none"
                    transform="scale(1 -1)"
                  />
                </g>
              </>
            )}
            {a && b && <line class="distance" x1={a.x} y1={a.y} x2={b.x} y2={b.y} />}
            {ends.map((end, i) => (
              <circle key={i} class="distance-end" cx={end.x} cy={end.y} r={span * 0.008} />
            ))}
          </g>
        </svg>
        <div class="scale small num" style={{ width: `${(bar / span) * 100}%` }}>{micrometres(bar)}</div>
        {note}
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
      {children}
      {measuring.value && (
        <figcaption class="measure-caption">
          <p class="soft small">Click near a contour, or choose two of its points.</p>
          <ContourPointInputs section={section} points={points.value} onChange={(next) => (points.value = next)} />
          <p role="status" class="measured num">
            {distance !== undefined && <>Distance <strong data-um={distance}>{micrometres(distance)}</strong></>}
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
