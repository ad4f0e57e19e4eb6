// The canvas of the growing tube.
import { useEffect, useRef, useState } from "preact/hooks";
import type { LiveSection } from "../models.ts";
import { dark, stillness } from "../ui/theme.ts";
import { short } from "../ui/format.ts";
import type { Tube } from "./tube.ts";

/** Turn of the tube per arrow key and per pixel of a drag, radians. */
const [STEP, PER_PIXEL] = [0.12, 0.008];
const TURNS: Record<string, [number, number]> = {
  ArrowLeft: [STEP, 0],
  ArrowRight: [-STEP, 0],
  ArrowUp: [0, STEP],
  ArrowDown: [0, -STEP],
};

/**
 * Reasons why there is no drawing: the module failed to load, WebGL2 is missing, or its context is
 * lost.
 */
export type Trouble = "unloaded" | "missing" | "lost";

interface Props {
  sections: readonly LiveSection[];
  /** Length of the whole tube, micrometres. */
  length: number;
  /**
   * Called with the reason why the tube cannot be drawn, and with undefined when it is drawn again.
   */
  onTrouble: (trouble: Trouble | undefined) => void;
}

/** The sections received so far, as a tube in 3D. */
export function Stage({ sections, length, onTrouble }: Props) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const [isthmus, ampulla] = [useRef<HTMLSpanElement>(null), useRef<HTMLSpanElement>(null)];
  const [scene, setScene] = useState<Tube>();

  useEffect(() => {
    const element = canvas.current!;
    let made: Tube | undefined;
    let left = false;
    const make = ({ Tube }: typeof import("./tube.ts")) => {
      if (left) return;
      try {
        made = new Tube(element, length, [isthmus.current!, ampulla.current!]);
        setScene(made);
        onTrouble(undefined);
      } catch {
        onTrouble("missing");
      }
    };
    const load = () => void import("./tube.ts").then(make, () => left || onTrouble("unloaded"));
    // A lost context has already destroyed its resources; deleting them afterwards would be an
    // error.
    const lose = (event: Event) => {
      event.preventDefault();
      made?.dispose();
      made = undefined;
      setScene(undefined);
      onTrouble("lost");
    };
    element.addEventListener("webglcontextlost", lose);
    element.addEventListener("webglcontextrestored", load);
    load();
    return () => {
      left = true;
      element.removeEventListener("webglcontextlost", lose);
      element.removeEventListener("webglcontextrestored", load);
      made?.dispose();
    };
  }, [length]);

  useEffect(() => {
    if (!scene) return;
    const element = canvas.current!;
    const watcher = new ResizeObserver(() => scene.resize(element.clientWidth, element.clientHeight));
    watcher.observe(element);
    return () => watcher.disconnect();
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
    <figure class="growing-canvas">
      <canvas
        ref={canvas} role="img" tabIndex={0} onPointerMove={drag} onKeyDown={press}
        onPointerDown={(event) => canvas.current?.setPointerCapture(event.pointerId)}
        aria-label={`The growing tube in 3D, ${sections.length} sections seen. Arrow keys turn it.`}
      />
      <span ref={isthmus} class="growing-end">isthmus</span>
      <span ref={ampulla} class="growing-end">ampulla</span>
      {scene && sections.length > 0 && scene.compression > 1.5 && (
        <figcaption class="small soft">The length is drawn {short(Math.round(scene.compression))} times shorter than it is.</figcaption>
      )}
    </figure>
  );
}

/** The colours of the theme at an element. */
function colours(element: HTMLElement) {
  const colour = (name: string) => {
    element.style.color = `var(${name})`;
    return getComputedStyle(element).color;
  };
  return { ground: colour("--surface"), tissue: colour("--tissue"), mucosa: colour("--mucosa"), ink: colour("--ink") };
}
