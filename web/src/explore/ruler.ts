// The measured distance, drawn over the 3D picture.
import { Vector3 } from "three";
import { micrometres } from "../ui/format.ts";
import type { Measurement } from "./measure.ts";
import type { Stage } from "./viewer/stage.ts";

export class Ruler {
  readonly #overlay: SVGSVGElement;
  readonly #lines: NodeListOf<SVGLineElement>;
  readonly #ends: NodeListOf<SVGCircleElement>;
  readonly #label: SVGTextElement;
  readonly #a = new Vector3();
  readonly #b = new Vector3();
  /** Distance on the label, micrometres. */
  #distance: number | undefined;

  constructor(overlay: SVGSVGElement) {
    this.#overlay = overlay;
    this.#lines = overlay.querySelectorAll("line");
    this.#ends = overlay.querySelectorAll("circle");
    this.#label = overlay.querySelector("text")!;
  }

  /**
   * Moves line, ends and label to their positions in the picture. Call after each frame, outside
   * effects.
   */
  draw({ a: from, b: to, distance }: Measurement, stage: Stage): void {
    const start = from.value;
    const end = to.value ?? start;
    const a = this.#a;
    const b = this.#b;
    const seen = start !== undefined && end !== undefined && stage.project(start, a) && stage.project(end, b);
    this.#overlay.style.display = seen ? "" : "none";
    if (!seen) return;
    // Numeric properties avoid the new strings that attributes would need in each frame.
    for (let i = 0; i < this.#lines.length; i++) {
      const { x1, y1, x2, y2 } = this.#lines[i]!;
      x1.baseVal.value = a.x;
      y1.baseVal.value = a.y;
      x2.baseVal.value = b.x;
      y2.baseVal.value = b.y;
    }
    for (let i = 0; i < this.#ends.length; i++) {
      const { cx, cy } = this.#ends[i]!;
      cx.baseVal.value = i === 0 ? a.x : b.x;
      cy.baseVal.value = i === 0 ? a.y : b.y;
    }
    this.#label.x.baseVal.getItem(0).value = (a.x + b.x) / 2;
    this.#label.y.baseVal.getItem(0).value = (a.y + b.y) / 2 - 10;
    if (distance.value === this.#distance) return;
    this.#distance = distance.value;
    this.#label.textContent = this.#distance === undefined ? "" : micrometres(this.#distance);
  }
}
