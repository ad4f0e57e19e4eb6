// Over the picture during the flight: what it waits for, and the cut at the place of the camera.
import { useMemo } from "preact/hooks";
import { short } from "../ui/format.ts";
import { pathData, thinned } from "./contours.ts";
import { extentOf, ofCut } from "./cross-section.ts";
import type { Exploration } from "./exploration.ts";
import { windowOf } from "./section-window.ts";
import type { View } from "./view.ts";
import { bearing } from "./way.ts";

interface Props {
  exploration: Exploration;
  view: View;
}

/** Says why the flight shows the model from outside. */
export function FlightNote({ exploration, view }: Props) {
  const obstacle = exploration.obstacle.value;
  if (!obstacle || !view.flying.value) return null;
  const { words, state } = obstacle;
  return (
    <div class="picture-flight small" role="status" aria-busy={state === "waiting"}>
      <p>{words}</p>
      {state === "failed" && (
        <button type="button" class="button" onClick={() => exploration.removeObstacle()}>Try again</button>
      )}
      <button type="button" class="button" onClick={() => (view.flight.value = undefined)}>Leave the flight</button>
    </div>
  );
}

/** Number of points that the outlines of the inset may have across it. */
const FINENESS = 250;

/** The last cut, with the place of the camera in it. A click leads to the cross section. */
export function FlightInset({ exploration, view, section }: Props & { section: string }) {
  const { cuts, passage, tube, obstacle } = exploration;
  const way = passage.way.value;
  const cut = cuts.outcome.value?.value?.cut;
  const drawn = useMemo(() => {
    if (!cut) return undefined;
    const shape = ofCut(cut);
    const whole = windowOf(extentOf(shape));
    const paths = shape.contours.map((contour) => ({
      kind: contour.kind, data: pathData(thinned(contour, whole.span / FINENESS)),
    }));
    return { whole, paths };
  }, [cut]);
  if (!view.flying.value || obstacle.value || !way || !cut || !drawn) return null;
  const z_um = Number(cuts.outcome.value!.key);
  const { u, v, up } = bearing(way, tube, z_um / 1000 - tube.begin, cut.plane);
  const { x, y, span } = drawn.whole;
  const place = `${short(z_um / 1000)} mm`;
  const leave = () => {
    view.flight.value = undefined;
    document.getElementById(section)?.scrollIntoView();
  };
  const turned = (-Math.atan2(up[0], up[1]) * 180) / Math.PI;
  const camera = `translate(${u} ${v}) rotate(${turned}) scale(${span / 100})`;
  return (
    <button
      type="button"
      class="picture-inset contours"
      aria-label={`Show the cross section at ${place}`}
      title={`Cross section at ${place}`}
      onClick={leave}
    >
      <svg viewBox={`${x - span / 2} ${-y - span / 2} ${span} ${span}`} aria-hidden="true" data-z-um={z_um}>
        <g transform="scale(1 -1)">
          {drawn.paths.map(({ kind, data }, k) => <path key={k} class={kind} d={data} />)}
          <g class="inset-camera" transform={camera}>
            {/* The arrow points up in the picture of the flight. */}
            <path d="M0 10L3 4L-3 4Z" />
            <circle r="2.5" />
          </g>
        </g>
      </svg>
    </button>
  );
}
