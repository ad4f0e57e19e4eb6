// Standard views: the camera distance at which the tube fills the picture.
import type { Course } from "./course.ts";
import type { Placement, StandardView } from "./pose.ts";

/** A tube along z in millimetres, or along its course, where z is the position along the course. */
export interface Tube {
  /**
   * Position of the lower end along the whole tube, for a piece. In these coordinates, that end is
   * at z = 0.
   */
  begin: number;
  length: number;
  /** Radius of the smallest cylinder around the tube. */
  radius: number;
  /** Centre of the cross section. */
  x: number;
  y: number;
  /** Course of a bent tube. */
  course?: Course | undefined;
}

/** The part of a tube that is not cut away, as fractions of its length. */
export interface Kept {
  from: number;
  to: number;
}

/** Vertical angle of view of the camera, degrees. */
export const FIELD = 35;
/** Fraction of the picture that the tube may fill. */
const FILLED = 0.9;
const AROUND = 24;

/** The camera placement for a view of the kept part of a tube; `aspect` is width by height. */
export function standardView(view: StandardView, tube: Tube, kept: Kept, aspect: number): Placement {
  const { course } = tube;
  switch (view) {
    case "isthmus":
      if (course) return facing(tube, course, kept.from, -1, aspect);
      return { x: tube.x, y: tube.y, z: kept.from, azimuth: 180, elevation: 0, distance: endDistance(tube, aspect) };
    case "ampulla":
      if (course) return facing(tube, course, kept.to, 1, aspect);
      return { x: tube.x, y: tube.y, z: kept.to, azimuth: 0, elevation: 0, distance: endDistance(tube, aspect) };
    case "side":
      return frame(tube, kept, -90, 0, aspect);
    case "whole":
      if (course && !course.isStraight) return frame(tube, kept, ...broadest(tube, course, aspect), aspect);
      // Seen from the ampulla end: across a wide picture, or up a tall one.
      return aspect > 1 ? frame(tube, kept, -24, 10, aspect) : frame(tube, kept, -9, 20, aspect);
  }
}

/** Pixels per millimetre at a distance from the camera, in a picture of this height. */
export function pixelsPerMillimetre(distance: number, height: number): number {
  return height / (2 * distance * Math.tan(((FIELD / 2) * Math.PI) / 180));
}

/** Distance of a point in front of the camera along the line of sight, millimetres. */
export function depthOf(camera: Placement, { length }: Pick<Tube, "length">, point: { x: number; y: number; z: number }): number {
  const [a, e] = [(camera.azimuth * Math.PI) / 180, (camera.elevation * Math.PI) / 180];
  const [dx, dy, dz] = [point.x - camera.x, point.y - camera.y, point.z - camera.z * length];
  return camera.distance - (dx * Math.cos(e) * Math.sin(a) + dy * Math.sin(e) + dz * Math.cos(e) * Math.cos(a));
}

/** Extent of the tube along z, as fractions of its length. */
export function reachOf({ course, length }: Tube): readonly [number, number] {
  return course ? [course.low[2] / length, course.high[2] / length] : [0, 1];
}

/** The middle point of the axis. */
export function middleOf({ x, y, length, course }: Tube): { x: number; y: number; z: number } {
  const middle = new Point();
  middle.set(x, y, length / 2);
  course?.bend(x, y, length / 2, middle);
  return { x: middle.x, y: middle.y, z: middle.z };
}

/** Number of points of the centre line to which views of a bent tube are fitted. */
const ALONG = 96;
/**
 * Step and range of tested directions for the view of the whole tube, degrees.
 *
 * Seen from steeply above, a tube hardly seems to turn.
 */
const STEP = 5;
const ELEVATIONS = [-15, 60] as const;
/** Cosine of the maximum angle between these directions and the direction of minimum depth. */
const AWAY = Math.cos((32 * Math.PI) / 180);
/**
 * Weights, relative to size, of seeing the ampulla's face and of having the isthmus left or above.
 */
const FACE = 0.25;
const ORDER = 0.15;

/** View of an end from beyond it. */
function facing(tube: Tube, course: Course, at: number, sign: number, aspect: number): Placement {
  const [back, target] = [new Point(), new Point()];
  course.turn(0, 0, sign, at * tube.length, back);
  course.bend(tube.x, tube.y, at * tube.length, target);
  const elevation = Math.max(-89, Math.min(89, (Math.asin(Math.max(-1, Math.min(1, back.y))) * 180) / Math.PI));
  const azimuth = (Math.atan2(back.x, back.z) * 180) / Math.PI;
  return { x: target.x, y: target.y, z: target.z / tube.length, azimuth, elevation, distance: endDistance(tube, aspect) };
}

/** Azimuth and elevation from which the course has little depth and well placed ends. */
function broadest({ radius }: Tube, course: Course, aspect: number): [number, number] {
  const points = courseOf(course);
  const face = new Point();
  course.turn(0, 0, 1, course.length, face);
  const depth = ({ back }: Directions) => {
    const at = points.map((point) => dot(point, back));
    const middle = mean(at);
    return mean(at.map((value) => (value - middle) ** 2));
  };
  const flattest = least(around(0, 90), depth);
  const choices = around(...ELEVATIONS).filter(({ back }) => Math.abs(dot(back, flattest.back)) >= AWAY);
  const { azimuth, elevation } = least(choices, ({ back, right, up }) => {
    const [across, upward] = [right, up].map((axis) => points.map((point) => dot(point, axis))) as [number[], number[]];
    const inOrder = aspect > 1 ? across[0]! < across.at(-1)! : upward[0]! > upward.at(-1)!;
    const size = Math.max((range(across) + 2 * radius) / aspect, range(upward) + 2 * radius);
    return size * (1 - FACE * dot([face.x, face.y, face.z], back)) * (inOrder ? 1 : 1 + ORDER);
  });
  return [azimuth, elevation];
}

/** Directions all around, between two elevations. */
function around(lowest: number, highest: number): Directions[] {
  const elevations = Array.from({ length: (highest - lowest) / STEP + 1 }, (_, i) => lowest + i * STEP);
  return elevations.flatMap((elevation) => Array.from({ length: 360 / STEP }, (_, i) => directions(i * STEP - 180, elevation)));
}

function least<T>(choices: readonly T[], cost: (choice: T) => number): T {
  const costs = choices.map(cost);
  return choices[costs.indexOf(Math.min(...costs))]!;
}

/** Angle of a lengthwise cut that opens a bent tube towards the view of the whole tube. */
export function openingAngle(tube: Tube, course: Course, aspect: number): number {
  const { back } = directions(...broadest(tube, course, aspect));
  const point = new Point();
  const towards = (x: number, y: number) => mean(Array.from({ length: ALONG }, (_, i) => {
    course.turn(x, y, 0, (tube.length * i) / (ALONG - 1), point);
    return dot([point.x, point.y, point.z], back);
  }));
  return Math.round((Math.atan2(-towards(0, 1), -towards(1, 0)) * 180) / Math.PI);
}

/** Points of a centre line. */
function courseOf(course: Course): Triple[] {
  const point = new Point();
  return Array.from({ length: ALONG }, (_, i) => {
    course.bend(0, 0, (course.length * i) / (ALONG - 1), point);
    return [point.x, point.y, point.z];
  });
}

function range(values: readonly number[]): number {
  return Math.max(...values) - Math.min(...values);
}

class Point {
  x = 0;
  y = 0;
  z = 0;

  set(x: number, y: number, z: number): void {
    [this.x, this.y, this.z] = [x, y, z];
  }
}

function endDistance({ radius }: Tube, aspect: number): number {
  return radius / (Math.tan(((FIELD / 2) * Math.PI) / 180) * Math.min(aspect, 1) * FILLED);
}

/** The nearest placement in a direction from which the whole kept part is visible. */
function frame(tube: Tube, kept: Kept, azimuth: number, elevation: number, aspect: number): Placement {
  const { back, right, up } = directions(azimuth, elevation);
  const slopeY = Math.tan(((FIELD / 2) * Math.PI) / 180) * FILLED;
  const across = new Extent(slopeY * aspect);
  const upward = new Extent(slopeY);
  const points = outermost(tube, kept);
  for (const point of points) {
    across.add(dot(point, right), dot(point, back));
    upward.add(dot(point, up), dot(point, back));
  }
  const height = Math.max(across.height(), upward.height());
  const [u, v] = [across.middle(), upward.middle()];
  const eye = [0, 1, 2].map((i) => right[i]! * u + up[i]! * v + back[i]! * height) as [number, number, number];
  const distance = tube.course ? dot(eye, back) - mean(points.map((point) => dot(point, back))) : distanceToAxis(eye, back, tube, kept);
  const target = eye.map((at, i) => at - back[i]! * distance) as [number, number, number];
  return { x: target[0], y: target[1], z: target[2] / tube.length, azimuth, elevation, distance };
}

type Triple = readonly [number, number, number];

/** Direction towards the camera, and the directions right and up in its picture. */
interface Directions {
  azimuth: number;
  elevation: number;
  back: Triple;
  right: Triple;
  up: Triple;
}

function directions(azimuth: number, elevation: number): Directions {
  const [a, e] = [(azimuth * Math.PI) / 180, (elevation * Math.PI) / 180];
  return {
    azimuth,
    elevation,
    back: [Math.cos(e) * Math.sin(a), Math.sin(e), Math.cos(e) * Math.cos(a)],
    right: [Math.cos(a), 0, -Math.sin(a)],
    up: [-Math.sin(e) * Math.sin(a), Math.cos(e), -Math.sin(e) * Math.cos(a)],
  };
}

/** Points around the kept part of a tube: around its ends, and along a bent tube. */
function outermost({ x, y, radius, length, course }: Tube, { from, to }: Kept): Triple[] {
  const rings = course ? ALONG : 2;
  const around = course ? AROUND / 3 : AROUND;
  const point = new Point();
  return Array.from({ length: rings * around }, (_, i) => {
    const turn = (2 * Math.PI * (i % around)) / around;
    const at = from + ((to - from) * Math.floor(i / around)) / (rings - 1);
    point.set(x + radius * Math.cos(turn), y + radius * Math.sin(turn), at * length);
    course?.bend(point.x, point.y, point.z, point);
    return [point.x, point.y, point.z];
  });
}

function mean(values: readonly number[]): number {
  return values.reduce((sum, value) => sum + value, 0) / values.length;
}

/** Distance from the eye to the point of its line of sight nearest to the axis of the kept part. */
function distanceToAxis(eye: Triple, back: Triple, tube: Tube, { from, to }: Kept): number {
  const [dx, dy] = [eye[0] - tube.x, eye[1] - tube.y];
  const nearest = (dx * back[0] + dy * back[1]) / (back[0] ** 2 + back[1] ** 2);
  const z = Math.max(from * tube.length, Math.min(to * tube.length, eye[2] - nearest * back[2]));
  return Math.abs(back[2]) < 1e-9 ? nearest : (eye[2] - z) / back[2];
}

function dot(a: Triple, b: Triple): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/** Range of eye positions that see all added points under a limited slope, in one direction. */
class Extent {
  readonly #slope: number;
  #low = Infinity;
  #high = -Infinity;

  constructor(slope: number) {
    this.#slope = slope;
  }

  /** Adds a point by its position across the picture and its height towards the eye. */
  add(at: number, height: number): void {
    this.#high = Math.max(this.#high, at + height * this.#slope);
    this.#low = Math.min(this.#low, at - height * this.#slope);
  }

  /** Minimum height of the eye. */
  height(): number {
    return (this.#high - this.#low) / (2 * this.#slope);
  }

  /** Middle of the range of eye positions. */
  middle(): number {
    return (this.#high + this.#low) / 2;
  }
}
