// The names of the tube's ends and a scale bar, over the 3D picture.
import { Vector3 } from "three";
import { roundLength } from "../growing/contours.ts";
import { micrometres } from "../ui/format.ts";
import { depthOf, pixelsPerMillimetre, type Tube } from "./framing.ts";
import type { Pose } from "./pose.ts";
import type { Stage } from "./viewer/stage.ts";
import type { Surface } from "./viewer/surface.ts";
import type { View } from "./view.ts";

/** Maximum width of the scale bar, pixels. */
const BAR = 110;
/**
 * Layout of a name, in pixels.
 *
 * Distance from the rim of the end down or up to the name's line, from that line to the edges of
 * the picture, and half of the name's width.
 */
const [BELOW, ABOVE, EDGE, HALF] = [18, 8, 8, 36];

export class Signs {
  readonly #overlay: SVGSVGElement;
  readonly #names: NodeListOf<SVGTextElement>;
  readonly #scale: HTMLElement;
  readonly #bar: HTMLElement;
  readonly #tube: Tube;
  readonly #pose: Pose;
  readonly #ends: readonly [End, End];
  #shown = false;
  /** Length of the scale bar in millimetres and in pixels. */
  #length = 0;
  #width = 0;

  /**
   * `overlay` contains the names of isthmus and ampulla; `scale` is the element of the scale bar.
   */
  constructor(overlay: SVGSVGElement, scale: HTMLElement, tube: Tube, pose: Pose) {
    this.#tube = tube;
    this.#pose = pose;
    this.#ends = [new End(tube), new End(tube)];
    this.#overlay = overlay;
    this.#names = overlay.querySelectorAll("text");
    this.#scale = scale;
    this.#bar = scale.querySelector("b")!;
  }

  /** Sets the positions of the names from the ends of a surface. */
  show({ patches }: Surface): void {
    for (const { name, straight } of patches) {
      if (name === "cap_isthmus") this.#ends[0].fit(straight);
      else if (name === "cap_ampulla") this.#ends[1].fit(straight);
    }
  }

  /** Moves names and scale bar to their positions. Call after each frame, outside effects. */
  draw(view: View, stage: Stage): void {
    const shown = !view.flying.value;
    if (shown !== this.#shown) {
      this.#shown = shown;
      this.#scale.hidden = !shown;
      this.#overlay.style.display = shown ? "" : "none";
    }
    if (!shown) return;
    const { clientWidth: width, clientHeight: height } = this.#scale.parentElement!;
    const perMillimetre = pixelsPerMillimetre(this.#pose.distance, height);
    const [isthmus, ampulla] = this.#ends;
    const { from, to } = view.kept;
    isthmus.look(this.#pose, this.#tube, from, stage, perMillimetre);
    ampulla.look(this.#pose, this.#tube, to, stage, perMillimetre);
    const covered = isthmus.covers(ampulla) ? ampulla : ampulla.covers(isthmus) ? isthmus : undefined;
    for (let i = 0; i < 2; i++) {
      const end = this.#ends[i]!;
      const name = this.#names[i]!;
      const seen = end !== covered && end.before && (i === 0 ? from === 0 : to === 1) && end.x > 0 && end.x < width && end.y > 0 && end.y < height;
      name.style.display = seen ? "" : "none";
      // Numeric properties avoid the new strings that attributes would need in each frame.
      name.x.baseVal.getItem(0).value = Math.max(HALF, Math.min(width - HALF, end.x));
      // Place the name on the side away from the tube.
      const other = this.#ends[1 - i]!;
      const above = other.before && other.y > end.y + end.radius;
      const y = above ? end.y - end.radius - ABOVE : end.y + end.radius + BELOW;
      name.y.baseVal.getItem(0).value = Math.max(EDGE + ABOVE, Math.min(height - EDGE, y));
    }
    this.#measure(perMillimetre);
  }

  #measure(perMillimetre: number): void {
    const length = roundLength(BAR / perMillimetre);
    const width = length * perMillimetre;
    if (length !== this.#length) this.#bar.textContent = micrometres(length * 1000);
    if (width !== this.#width) this.#bar.style.width = `${width.toFixed(1)}px`;
    [this.#length, this.#width] = [length, width];
  }
}

/** An end of the kept part of the tube: the projected circle around it, in pixels. */
class End {
  x = 0;
  y = 0;
  radius = 0;
  depth = 0;
  /** True if the end is in front of the camera. */
  before = false;
  readonly #at = new Vector3();
  /** The circle itself, millimetres. */
  #circle: { x: number; y: number; radius: number };

  constructor(circle: { x: number; y: number; radius: number }) {
    this.#circle = circle;
  }

  /** Fits the circle to points. */
  fit(positions: Float32Array): void {
    let [left, right, bottom, top] = [Infinity, -Infinity, Infinity, -Infinity];
    for (let i = 0; i < positions.length; i += 3) {
      const [x, y] = [positions[i]!, positions[i + 1]!];
      [left, right, bottom, top] = [Math.min(left, x), Math.max(right, x), Math.min(bottom, y), Math.max(top, y)];
    }
    this.#circle = { x: (left + right) / 2, y: (bottom + top) / 2, radius: Math.max(right - left, top - bottom) / 2 };
  }

  look(pose: Pose, tube: Tube, at: number, stage: Stage, perMillimetre: number): void {
    const { x, y, radius } = this.#circle;
    const spot = this.#at.set(x, y, at * tube.length);
    tube.course?.bend(spot.x, spot.y, spot.z, spot);
    this.depth = depthOf(pose, tube, spot);
    this.radius = (radius * perMillimetre * pose.distance) / this.depth;
    this.before = this.depth > 0;
    stage.project(spot, spot);
    [this.x, this.y] = [spot.x, spot.y];
  }

  /** True if this end hides the other one. */
  covers(other: End): boolean {
    return this.before && this.depth < other.depth && Math.hypot(this.x - other.x, this.y - other.y) < this.radius;
  }
}
