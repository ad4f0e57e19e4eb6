// Standard views: how far away the camera must be for the tube to fill the picture.
import type { Placement, StandardView } from "./pose.ts";

/** A tube along z, millimetres. */
export interface Tube {
  /** Where it begins along the whole tube, if it is a piece of it. Here, its lower end is at z = 0. */
  begin: number;
  length: number;
  /** Of the smallest cylinder around it. */
  radius: number;
  /** Centre of its cross section. */
  x: number;
  y: number;
}

/** The part of a tube that is not cut away, as fractions of its length. */
export interface Kept {
  from: number;
  to: number;
}

/** Vertical angle of the camera's view, degrees. */
export const FIELD = 35;
/** Part of the picture that the tube may fill. */
const FILLED = 0.9;
const AROUND = 24;

/** The placement for a view of what is kept of a tube; `aspect` is the picture's width by its height. */
export function standardView(view: StandardView, tube: Tube, kept: Kept, aspect: number): Placement {
  switch (view) {
    case "isthmus":
      return { x: tube.x, y: tube.y, z: kept.from, azimuth: 180, elevation: 0, distance: endDistance(tube, aspect) };
    case "ampulla":
      return { x: tube.x, y: tube.y, z: kept.to, azimuth: 0, elevation: 0, distance: endDistance(tube, aspect) };
    case "side":
      return frame(tube, kept, -90, 0, aspect);
    case "whole":
      // From the ampulla end, receding: across a wide picture, up a tall one.
      return aspect > 1 ? frame(tube, kept, -24, 10, aspect) : frame(tube, kept, -9, 20, aspect);
  }
}

/** Pixels of a millimetre at a distance from the camera, in a picture of so many pixels height. */
export function pixelsPerMillimetre(distance: number, height: number): number {
  return height / (2 * distance * Math.tan(((FIELD / 2) * Math.PI) / 180));
}

/** How far before the camera a point is, along the line of sight; millimetres. */
export function depthOf(camera: Placement, { length }: Pick<Tube, "length">, point: { x: number; y: number; z: number }): number {
  const [a, e] = [(camera.azimuth * Math.PI) / 180, (camera.elevation * Math.PI) / 180];
  const [dx, dy, dz] = [point.x - camera.x, point.y - camera.y, point.z - camera.z * length];
  return camera.distance - (dx * Math.cos(e) * Math.sin(a) + dy * Math.sin(e) + dz * Math.cos(e) * Math.cos(a));
}

function endDistance({ radius }: Tube, aspect: number): number {
  return radius / (Math.tan(((FIELD / 2) * Math.PI) / 180) * Math.min(aspect, 1) * FILLED);
}

/** The nearest placement in a direction from which all of it is seen. */
function frame(tube: Tube, kept: Kept, azimuth: number, elevation: number, aspect: number): Placement {
  const [a, e] = [(azimuth * Math.PI) / 180, (elevation * Math.PI) / 180];
  const back = [Math.cos(e) * Math.sin(a), Math.sin(e), Math.cos(e) * Math.cos(a)] as const;
  const right = [Math.cos(a), 0, -Math.sin(a)] as const;
  const up = [-Math.sin(e) * Math.sin(a), Math.cos(e), -Math.sin(e) * Math.cos(a)] as const;
  const slopeY = Math.tan(((FIELD / 2) * Math.PI) / 180) * FILLED;
  const across = new Extent(slopeY * aspect);
  const upward = new Extent(slopeY);
  for (let i = 0; i < 2 * AROUND; i++) {
    const turn = (2 * Math.PI * i) / AROUND;
    const point = [tube.x + tube.radius * Math.cos(turn), tube.y + tube.radius * Math.sin(turn), (i < AROUND ? kept.from : kept.to) * tube.length] as const;
    across.add(dot(point, right), dot(point, back));
    upward.add(dot(point, up), dot(point, back));
  }
  const height = Math.max(across.height(), upward.height());
  const [u, v] = [across.middle(), upward.middle()];
  const eye = [0, 1, 2].map((i) => right[i]! * u + up[i]! * v + back[i]! * height) as [number, number, number];
  const distance = distanceToAxis(eye, back, tube, kept);
  const target = eye.map((at, i) => at - back[i]! * distance) as [number, number, number];
  return { x: target[0], y: target[1], z: target[2] / tube.length, azimuth, elevation, distance };
}

type Triple = readonly [number, number, number];

/** From the eye to the point of its line of sight that is nearest to the tube's axis, within what is kept. */
function distanceToAxis(eye: Triple, back: Triple, tube: Tube, { from, to }: Kept): number {
  const [dx, dy] = [eye[0] - tube.x, eye[1] - tube.y];
  const nearest = (dx * back[0] + dy * back[1]) / (back[0] ** 2 + back[1] ** 2);
  const z = Math.max(from * tube.length, Math.min(to * tube.length, eye[2] - nearest * back[2]));
  return Math.abs(back[2]) < 1e-9 ? nearest : (eye[2] - z) / back[2];
}

function dot(a: Triple, b: Triple): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/** Where an eye sees points under a slope at most, in one direction of the picture. */
class Extent {
  readonly #slope: number;
  #low = Infinity;
  #high = -Infinity;

  constructor(slope: number) {
    this.#slope = slope;
  }

  /** Adds a point by its position across and its height towards the eye. */
  add(at: number, height: number): void {
    this.#high = Math.max(this.#high, at + height * this.#slope);
    this.#low = Math.min(this.#low, at - height * this.#slope);
  }

  /** The least height of the eye. */
  height(): number {
    return (this.#high - this.#low) / (2 * this.#slope);
  }

  /** Where the eye is in the middle of what it may be. */
  middle(): number {
    return (this.#high + this.#low) / 2;
  }
}
