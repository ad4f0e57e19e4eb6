// The measured distance, drawn over the 3D picture.
import { Vector3 } from "three";
import { micrometres } from "../ui/format.ts";
import type { Measurement } from "./measure.ts";
import type { Stage } from "./viewer/stage.ts";

const [a, b] = [new Vector3(), new Vector3()];

/** Moves line, ends and label to where they are in the picture; to be called after each frame. */
export function drawRuler(overlay: SVGSVGElement, { a: from, b: to, distance }: Measurement, stage: Stage): void {
  const start = from.peek();
  const end = to.peek() ?? start;
  const seen = start !== undefined && end !== undefined && stage.project(start, a) && stage.project(end, b);
  overlay.style.display = seen ? "" : "none";
  if (!seen) return;
  for (const line of overlay.querySelectorAll("line")) set(line, { x1: a.x, y1: a.y, x2: b.x, y2: b.y });
  const [first, second] = overlay.querySelectorAll("circle");
  set(first!, { cx: a.x, cy: a.y });
  set(second!, { cx: b.x, cy: b.y });
  const label = overlay.querySelector("text")!;
  set(label, { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 - 10 });
  label.textContent = distance.peek() === undefined ? "" : micrometres(distance.peek()!);
}

function set(element: Element, attributes: Record<string, number>): void {
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value.toFixed(1));
}
