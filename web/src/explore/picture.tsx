// The 3D picture of a model with its overlays; a still picture if the browser cannot draw it.
import { effect, untracked } from "@preact/signals";
import { useEffect, useId, useRef, useState } from "preact/hooks";
import { bytes } from "../ui/format.ts";
import { Notice, ProgressBar } from "../ui/widgets.tsx";
import type { Contraction } from "./contraction.ts";
import type { Exploration } from "./exploration.ts";
import type { Flight } from "./flight.ts";
import { FlightInset, FlightNote } from "./flight-overlay.tsx";
import { Ruler } from "./ruler.ts";
import { Signs } from "./signs.ts";
import { Still } from "./still.tsx";
import type { View } from "./view.ts";
import { device } from "./viewer/device.ts";
import { Stage } from "./viewer/stage.ts";

interface Props {
  /** Name of the model in the label of the picture. */
  name: string;
  exploration: Exploration;
  view: View;
  flight: Flight;
  contraction?: Contraction;
  /** Id of the element that shows the cross section. */
  section: string;
}

export function Picture(props: Props) {
  const { name, exploration, view } = props;
  const canvas = useRef<HTMLCanvasElement>(null);
  const [ruler, names, scale] = [useRef<SVGSVGElement>(null), useRef<SVGSVGElement>(null), useRef<HTMLParagraphElement>(null)];
  const [stage, setStage] = useState<Stage | "impossible">();
  const help = useId();
  useEffect(() => {
    const stage = newStage(canvas.current!, view, exploration);
    setStage(stage ?? "impossible");
    if (!stage) return;
    const { pose } = view.viewpointOf(exploration.tube);
    const signs = new Signs(names.current!, scale.current!, exploration.tube, pose);
    const leave = connect(stage, props, new Ruler(ruler.current!), signs);
    return () => {
      leave();
      stage.dispose();
    };
  }, []);
  if (stage === "impossible") {
    return (
      <Still exploration={exploration}>
        This browser does not offer WebGL2, so the model cannot be turned. Sections, report and downloads work without it.
      </Still>
    );
  }
  return (
    <div class="picture">
      <canvas
        ref={canvas}
        tabIndex={0}
        role="application"
        aria-label={`3D view of ${name}`}
        aria-describedby={help}
        hidden={stage?.lost.value}
      />
      <p id={help} class="visually-hidden">
        Arrow keys turn the model, with Shift they move it, plus and minus zoom. Home or 1 shows the whole tube, 2 the isthmus end, 3 the
        ampulla end, 4 the side. In flight, arrow keys move, Space plays and pauses, Escape leaves.
      </p>
      <svg ref={names} class="picture-names small" style={{ display: "none" }} aria-hidden="true">
        <text x="0" y="0">isthmus</text>
        <text x="0" y="0">ampulla</text>
      </svg>
      <svg ref={ruler} class="ruler num" style={{ display: "none" }} aria-hidden="true">
        <line class="ruler-edge" />
        <line />
        <circle r="5" />
        <circle r="5" />
        <text x="0" y="0" />
      </svg>
      <p ref={scale} class="picture-scale small num" hidden title="At the depth of the point about which the picture turns; what is nearer looks larger">
        <span class="visually-hidden">Scale bar: </span><b />
      </p>
      <Loading exploration={exploration} />
      <FlightNote exploration={exploration} view={view} />
      <FlightInset exploration={exploration} view={view} section={props.section} />
      {stage?.lost.value && (
        <Still exploration={exploration}>
          The graphics processor is busy or was reset. The 3D view comes back by itself, or when you reload the page.
        </Still>
      )}
    </div>
  );
}

/** Creates the stage; undefined without WebGL2 or if no context is left. */
function newStage(canvas: HTMLCanvasElement, view: View, exploration: Exploration): Stage | undefined {
  const present = device();
  try {
    return present && new Stage(canvas, view, exploration.tube, present);
  } catch {
    return undefined;
  }
}

/**
 * Connects the loaded data and the measurement to the picture; returns a function that disconnects.
 */
function connect(stage: Stage, { exploration, view, flight, contraction }: Props, ruler: Ruler, signs: Signs): () => void {
  const { measurement } = exploration;
  void exploration.loadSurface();
  stage.onKey = flight.key;
  stage.onAdvance = (now) => {
    const flies = flight.advance(now);
    return contraction?.advance(now) || flies;
  };
  stage.onPick = (spot) => measurement.picking.peek() && measurement.pick(spot);
  stage.onFrame = () => {
    ruler.draw(measurement, stage);
    signs.draw(view, stage);
  };
  if (contraction) contraction.onMove = () => stage.moved();
  const leave = [
    () => {
      if (contraction) contraction.onMove = undefined;
    },
    effect(() => {
      const surface = contraction?.shown.value?.surface ?? exploration.surface.value;
      if (!surface) return;
      stage.show(surface);
      signs.show(surface);
    }),
    effect(() => {
      // A link to a flight needs the way at once; otherwise the model is shown first.
      if (view.flying.value || exploration.surface.value) untracked(() => exploration.passage.load());
    }),
    effect(() => {
      if (view.flying.value && exploration.surface.value) untracked(() => exploration.loadFlightLevel());
    }),
    effect(() => {
      stage.way = exploration.obstacle.value ? undefined : exploration.passage.way.value;
    }),
    effect(() => {
      void exploration.obstacle.value;
      if (flight.playing.value || contraction?.playing.value) stage.invalidate();
    }),
    effect(() => {
      void measurement.a.value;
      void measurement.b.value;
      stage.invalidate();
    }),
  ];
  return () => leave.forEach((end) => end());
}

function Loading({ exploration }: { exploration: Exploration }) {
  const { loading, surface, surfaceFault, levels } = exploration;
  if (levels.length === 0) {
    return (
      <Still exploration={exploration}>This model was grown without a 3D file that a browser can show (glb). Grow it again with the output glb.</Still>
    );
  }
  if (surfaceFault.value) {
    const { reason, left } = surfaceFault.value;
    const again = (
      <button type="button" class="button" onClick={() => exploration.retrySurface()}>
        Try again
      </button>
    );
    if (surface.value) {
      return (
        <div class="picture-progress small" role="alert">
          <p>{left[0]!.title} detail could not be loaded. {reason}</p>
          {again}
        </div>
      );
    }
    return (
      <div class="picture-message">
        <Notice title="The 3D file could not be loaded" kind="error">
          <p>{reason}</p>
          {again}
        </Notice>
      </div>
    );
  }
  if (!loading.value) return null;
  const { level, received } = loading.value;
  const text = `Loading ${level.title.toLowerCase()} detail: ${bytes(received)} of ${bytes(level.file.bytes)}`;
  return (
    <div class={surface.value ? "picture-progress small" : "picture-progress picture-progress-first"}>
      <span class="num">{text}</span>
      <ProgressBar fraction={received / level.file.bytes} label={`Loading ${level.title.toLowerCase()} detail`} />
    </div>
  );
}
