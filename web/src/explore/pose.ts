// Position of the camera on a sphere around a point of the tube. Lengths in millimetres, angles in
// degrees.
import { signal } from "@preact/signals";

export interface Placement {
  /**
   * Point at which the camera looks. `z` is a fraction of the tube's length, so links suit models
   * of other lengths.
   */
  x: number;
  y: number;
  z: number;
  /**
   * Angle around the vertical: 0 looks from the ampulla end, -90 from the side with the isthmus
   * left.
   */
  azimuth: number;
  elevation: number;
  distance: number;
}

export const STANDARD_VIEWS = ["whole", "isthmus", "ampulla", "side"] as const;
export type StandardView = (typeof STANDARD_VIEWS)[number];

/** Maximum elevation, because the vertical is undefined at the poles. */
const POLE = 89;
const NEAREST = 0.05;
const FARTHEST = 1000;
/** Duration of a change to another view, milliseconds. */
const GLIDE = 450;

export class Pose implements Placement {
  x = 0;
  y = 0;
  z = 0.5;
  azimuth = 0;
  elevation = 0;
  distance = 100;
  /** The shown standard view, until the pose changes. */
  standard: StandardView | undefined = "whole";
  /** Counter of changes. */
  readonly changes = signal(0);
  #from: Placement | undefined;
  #to: Placement | undefined;
  #began = 0;

  orbit(azimuth: number, elevation: number): void {
    this.#touch();
    this.azimuth = wrap(this.azimuth + azimuth);
    this.elevation = limit(this.elevation + elevation, -POLE, POLE);
    this.changes.value++;
  }

  /**
   * Moves the target in the plane of the picture, by millimetres to the right and up.
   *
   * `low` and `high` are the extent of the tube.
   */
  pan(right: number, up: number, length: number, [low, high]: readonly [number, number] = [0, 1]): void {
    this.#touch();
    const [a, e] = [(this.azimuth * Math.PI) / 180, (this.elevation * Math.PI) / 180];
    this.x += right * Math.cos(a) - up * Math.sin(e) * Math.sin(a);
    this.y += up * Math.cos(e);
    this.z = limit(this.z + (-right * Math.sin(a) - up * Math.sin(e) * Math.cos(a)) / length, low - 0.2, high + 0.2);
    this.changes.value++;
  }

  zoom(factor: number): void {
    this.#touch();
    this.distance = limit(this.distance * factor, NEAREST, FARTHEST);
    this.changes.value++;
  }

  place(placement: Placement, standard?: StandardView): void {
    this.#to = undefined;
    this.#assign(placement);
    this.standard = standard;
    this.changes.value++;
  }

  /** Starts a smooth movement; call `advance` in each frame. */
  glide(placement: Placement, standard: StandardView | undefined, now: number): void {
    this.#from = snapshot(this);
    // Turn the short way round.
    this.#from.azimuth = placement.azimuth + wrap(this.azimuth - placement.azimuth);
    this.#to = placement;
    this.#began = now;
    this.standard = standard;
    this.changes.value++;
  }

  /** Continues a movement. */
  advance(now: number): void {
    const from = this.#from;
    const to = this.#to;
    if (!from || !to) return;
    const t = limit((now - this.#began) / GLIDE, 0, 1);
    const eased = t * t * (3 - 2 * t);
    this.x = from.x + (to.x - from.x) * eased;
    this.y = from.y + (to.y - from.y) * eased;
    this.z = from.z + (to.z - from.z) * eased;
    this.azimuth = from.azimuth + (to.azimuth - from.azimuth) * eased;
    this.elevation = from.elevation + (to.elevation - from.elevation) * eased;
    this.distance = from.distance * (to.distance / from.distance) ** eased;
    if (t === 1) this.#to = undefined;
    this.changes.value++;
  }

  #touch(): void {
    this.#to = undefined;
    this.standard = undefined;
  }

  #assign({ x, y, z, azimuth, elevation, distance }: Placement): void {
    Object.assign(this, { x, y, z, azimuth, elevation, distance });
  }
}

function snapshot({ x, y, z, azimuth, elevation, distance }: Placement): Placement {
  return { x, y, z, azimuth, elevation, distance };
}

function limit(value: number, low: number, high: number): number {
  return Math.max(low, Math.min(high, value));
}

/** Wraps an angle to (-180, 180]. */
function wrap(degrees: number): number {
  const turned = ((degrees % 360) + 360) % 360;
  return turned > 180 ? turned - 360 : turned;
}
