// The shown content and its view, shared by the parts of a page and kept in its link.
import { computed, signal, type Signal } from "@preact/signals";
import { openingAngle, reachOf, standardView, type Kept, type Tube } from "./framing.ts";
import { Pose, STANDARD_VIEWS, type StandardView } from "./pose.ts";
import { LOOKS, type Look } from "./slides.ts";

export const PATCHES = ["inner", "outer", "caps"] as const;
export type PatchGroup = (typeof PATCHES)[number];

/** Viewpoint of a tube. */
export interface Viewpoint {
  readonly pose: Pose;
  /** The tube that standard views frame; for two tubes with one viewpoint, the longer one. */
  readonly tube: Tube;
  /** Width of the picture divided by its height. */
  aspect: number;
}

/**
 * State of a view. Positions are fractions of the tube's length, so models of different length
 * share a view.
 */
export class View {
  /** One viewpoint for all tubes, or one per tube; several move together. */
  readonly viewpoints: readonly [Viewpoint, ...Viewpoint[]];
  /** True if the tube is opened along its axis, and the angle of the cut in degrees. */
  readonly lengthwise = signal(false);
  readonly angle = signal(0);
  /** True if the tube is cut across, and the position of the cut. */
  readonly across = signal(false);
  readonly position = signal(0.75);
  /** True if the cut removes the isthmus side instead of the ampulla side. */
  readonly flipped = signal(false);
  readonly shown: Record<PatchGroup, Signal<boolean>> = { inner: signal(true), outer: signal(true), caps: signal(true) };
  readonly translucent = signal(false);
  /** Position of the section next to the model. */
  readonly section = signal(0.8);
  /** Look of the section. */
  readonly look = signal<Look>("contours");
  readonly plane = signal(false);
  /** Position of the flight, updated a few times per second; undefined outside the flight. */
  readonly flight = signal<number | undefined>(undefined);
  /** Position of the flight in the current frame. A signal would allocate memory in each frame. */
  flown = 0;
  /** Time of a contraction as a fraction of the period; undefined for the tube at rest. */
  readonly phase = signal<number | undefined>(undefined);
  readonly flying = computed(() => this.flight.value !== undefined);

  readonly #linked: readonly Signal[] = [
    this.lengthwise, this.angle, this.across, this.position, this.flipped, ...Object.values(this.shown),
    this.translucent, this.section, this.look, this.plane, this.flight, this.phase,
  ];

  constructor(...tubes: [Tube, ...Tube[]]) {
    this.viewpoints = tubes.map((tube) => ({ pose: new Pose(), tube, aspect: 1.5 })) as [Viewpoint, ...Viewpoint[]];
    const bent = this.viewpoints.find(({ tube }) => tube.course && !tube.course.isStraight);
    if (bent) this.angle.value = openingAngle(bent.tube, bent.tube.course!, bent.aspect);
    this.reframe();
  }

  /** Pose of the first viewpoint. */
  get pose(): Pose {
    return this.viewpoints[0].pose;
  }

  viewpointOf(tube: Tube): Viewpoint {
    return this.viewpoints.find((viewpoint) => viewpoint.tube === tube) ?? this.viewpoints[0];
  }

  /** True if all walls and caps are shown and opaque. */
  get closed(): boolean {
    return PATCHES.every((patch) => this.shown[patch].value) && !this.translucent.value;
  }

  /** Subscribes the calling effect to all state that a link keeps. */
  subscribe(): void {
    for (let i = 0; i < this.#linked.length; i++) void this.#linked[i]!.value;
    for (const { pose } of this.viewpoints) void pose.changes.value;
  }

  /**
   * Shows a standard view: moves there from `now` (milliseconds, as of frames), or jumps without
   * `now`.
   */
  show(standard: StandardView, now?: number): void {
    for (const viewpoint of this.viewpoints) this.frame(viewpoint, standard, now);
  }

  /** Shows a standard view of one viewpoint. */
  frame({ pose, tube, aspect }: Viewpoint, standard: StandardView, now?: number): void {
    const placement = standardView(standard, tube, this.kept, aspect);
    if (now === undefined) pose.place(placement, standard);
    else pose.glide(placement, standard, now);
  }

  /** Shows the cross section at a place; in a flight, the camera goes there. */
  goTo(place: number): void {
    (this.flying.peek() ? this.flight : this.section).value = place;
  }

  orbit(azimuth: number, elevation: number): void {
    for (const { pose } of this.viewpoints) pose.orbit(azimuth, elevation);
  }

  /**
   * Moves in the plane of the picture, by millimetres to the right and up in the picture of a tube.
   */
  pan(right: number, up: number, tube: Tube): void {
    const from = this.viewpointOf(tube).pose.distance;
    for (const viewpoint of this.viewpoints) {
      const seen = this.viewpoints.length > 1 ? viewpoint.tube : tube;
      const scale = viewpoint.pose.distance / from;
      viewpoint.pose.pan(right * scale, up * scale, seen.length, reachOf(seen));
    }
  }

  zoom(factor: number): void {
    for (const { pose } of this.viewpoints) pose.zoom(factor);
  }

  /** The part of the tube that the cut across leaves. */
  get kept(): Kept {
    const at = this.position.value;
    if (!this.across.value) return { from: 0, to: 1 };
    return this.flipped.value ? { from: at, to: 1 } : { from: 0, to: at };
  }

  /** Fits standard views to the current shape of the picture and the kept part. */
  reframe(): void {
    for (const viewpoint of this.viewpoints) if (viewpoint.pose.standard) this.frame(viewpoint, viewpoint.pose.standard);
  }
}

/** Names of view members in the query; other names belong to the page. */
const NAMES = ["cam", "cam2", "open", "cut", "flip", "hide", "glass", "at", "look", "plane", "fly", "phase"] as const;

/** Writes the view into a query, only as far as it differs from a new view. */
export function writeView(view: View, query: URLSearchParams): URLSearchParams {
  const result = new URLSearchParams(query);
  for (const name of NAMES) result.delete(name);
  const put = (name: (typeof NAMES)[number], value: string | undefined) => value !== undefined && result.set(name, value);
  view.viewpoints.forEach(({ pose }, k) => put(CAMERAS[k]!, writeCamera(pose)));
  put("open", view.lengthwise.value ? significant(view.angle.value, 4) : undefined);
  put("cut", view.across.value ? fraction(view.position.value) : undefined);
  put("flip", view.flipped.value ? "1" : undefined);
  const hidden = PATCHES.filter((patch) => !view.shown[patch].value);
  put("hide", hidden.length > 0 ? hidden.join("_") : undefined);
  put("glass", view.translucent.value ? "1" : undefined);
  put("at", fraction(view.section.value));
  put("look", view.look.value === "contours" ? undefined : view.look.value);
  put("plane", view.plane.value ? "1" : undefined);
  put("fly", view.flight.value === undefined ? undefined : fraction(view.flight.value));
  put("phase", view.phase.value === undefined ? undefined : fraction(view.phase.value));
  return result;
}

/** Restores a view. Missing and invalid members get the values of a new view. */
export function readView(view: View, query: URLSearchParams): void {
  const angle = number(query, "open", -360, 360);
  view.lengthwise.value = angle !== undefined;
  view.angle.value = angle ?? view.angle.value;
  const position = number(query, "cut", 0, 1);
  view.across.value = position !== undefined;
  view.position.value = position ?? view.position.value;
  view.flipped.value = query.get("flip") === "1";
  const hidden = query.get("hide")?.split("_") ?? [];
  for (const patch of PATCHES) view.shown[patch].value = !hidden.includes(patch);
  view.translucent.value = query.get("glass") === "1";
  view.look.value = LOOKS.find((look) => look === query.get("look")) ?? "contours";
  view.plane.value = query.get("plane") === "1";
  view.flight.value = number(query, "fly", 0, 1);
  // In a flight, the section is at its place.
  if (view.flight.value === undefined) view.section.value = number(query, "at", 0, 1) ?? view.section.value;
  view.phase.value = number(query, "phase", 0, 1);
  view.viewpoints.forEach((viewpoint, k) => readCamera(view, viewpoint, query.get(CAMERAS[k]!)));
}

const CAMERAS = ["cam", "cam2"] as const;

function writeCamera(pose: Pose): string | undefined {
  const numbers = [pose.azimuth, pose.elevation, pose.distance, pose.x, pose.y].map((value) => significant(value, 4));
  return pose.standard === "whole" ? undefined : (pose.standard ?? [...numbers, fraction(pose.z)].join("_"));
}

function readCamera(view: View, viewpoint: Viewpoint, camera: string | null): void {
  const [azimuth, elevation, distance, x, y, z] = camera?.split("_").map(Number) ?? [];
  const numbers = [azimuth, elevation, distance, x, y, z];
  if (numbers.every((value) => Number.isFinite(value)) && distance! > 0) {
    viewpoint.pose.place({ azimuth: azimuth!, elevation: elevation!, distance: distance!, x: x!, y: y!, z: z! });
  } else {
    view.frame(viewpoint, STANDARD_VIEWS.find((name) => name === camera) ?? "whole");
  }
}

function number(query: URLSearchParams, name: (typeof NAMES)[number], low: number, high: number): number | undefined {
  const text = query.get(name);
  const value = Number(text);
  return text === null || text === "" || !(value >= low && value <= high) ? undefined : value;
}

function significant(value: number, digits: number): string {
  return String(Number(value.toPrecision(digits)));
}

/** Five decimals, less than a micrometre of a tube. */
function fraction(value: number): string {
  return String(Math.round(value * 1e5) / 1e5);
}
