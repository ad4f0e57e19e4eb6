// The canvas of the growing tube.
import { useEffect, useRef, useState } from "preact/hooks";
import type { LiveSection } from "../models.ts";
import { dark, stillness } from "../ui/theme.ts";
import { short } from "../ui/format.ts";
import type { Tube } from "./tube.ts";

/** Radians by which an arrow key turns the tube, and a drag by one pixel. */
const [STEP, PER_PIXEL] = [0.12, 0.008];
const TURNS: Record<string, [number, number]> = {
  ArrowLeft: [STEP, 0],
  ArrowRight: [-STEP, 0],
  ArrowUp: [0, STEP],
  ArrowDown: [0, -STEP],
};

interface Props {
  sections: readonly LiveSection[];
  /** Of the whole tube, micrometres. */
  length: number;
  /** Called if WebGL2 is missing or was lost. */
  onUnavailable: () => void;
}

/** The sections seen so far as a tube in 3D. */
export function Stage({ sections, length, onUnavailable }: Props) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const [isthmus, ampulla] = [useRef<HTMLSpanElement>(null), useRef<HTMLSpanElement>(null)];
  const [scene, setScene] = useState<Tube>();

  useEffect(() => {
    let made: Tube | undefined;
    let left = false;
    import("./tube.ts")
      .then(({ Tube }) => {
        if (left) return;
        made = new Tube(canvas.current!, length, [isthmus.current!, ampulla.current!]);
        setScene(made);
      })
      .catch(onUnavailable);
    return () => {
      left = true;
      made?.dispose();
    };
  }, [length]);

  useEffect(() => {
    if (!scene) return;
    const element = canvas.current!;
    const watcher = new ResizeObserver(() => scene.resize(element.clientWidth, element.clientHeight));
    watcher.observe(element);
    element.addEventListener("webglcontextlost", onUnavailable);
    return () => {
      watcher.disconnect();
      element.removeEventListener("webglcontextlost", onUnavailable);
    };
  }, [scene]);
  useEffect(() => scene?.paint(colours(canvas.current!)), [scene, dark.value]);
  useEffect(() => scene?.sway(!stillness.value), [scene, stillness.value]);
  useEffect(() => scene?.show(sections), [scene, sections]);

  const drag = (event: PointerEvent) => {
    if (event.buttons === 1) scene?.turn(-event.movementX * PER_PIXEL, event.movementY * PER_PIXEL);
  };
  const press = (event: KeyboardEvent) => {
    const turn = TURNS[event.key];
    if (!turn) return;
    event.preventDefault();
    scene?.turn(...turn);
  };
  return (
    <figure class="stage">
      <canvas
        ref={canvas} role="img" tabIndex={0} onPointerMove={drag} onKeyDown={press}
        onPointerDown={(event) => canvas.current?.setPointerCapture(event.pointerId)}
        aria-label={`The growing tube in 3D, ${sections.length} sections seen. Arrow keys turn it.`}
      />
      <span ref={isthmus} class="stage-end">isthmus</span>
      <span ref={ampulla} class="stage-end">ampulla</span>
      {scene && sections.length > 0 && scene.compression > 1.5 && (
        <figcaption class="small soft">The length is drawn {short(Math.round(scene.compression))} times shorter than it is.</figcaption>
      )}
    </figure>
  );
}

/** The colours of the theme as they apply to an element. */
function colours(element: HTMLElement) {
  const colour = (name: string) => {
    element.style.color = `var(${name})`;
    return getComputedStyle(element).color;
  };
  return { ground: colour("--surface"), tissue: colour("--tissue"), mucosa: colour("--mucosa"), ink: colour("--ink") };
}
