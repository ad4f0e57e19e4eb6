// The camera of the flight: on the way through the lumen, looking along it.
import { Vector3, type PerspectiveCamera } from "three";
import type { Tube } from "../framing.ts";
import type { Way } from "../way.ts";

/** Vertical angle of view during the flight, degrees. */
export const FLIGHT_FIELD = 85;
/**
 * Least cosine of the angle between the line of sight and the axis of the tube. Across the tube,
 * the vertical of the picture would be undefined.
 */
const LEAST_ALONG = 0.35;
/** Limits of the distance of the near plane, millimetres; nearer planes blur the depths. */
const [NEAREST, FARTHEST] = [0.001, 0.02];
/** Part of the clearance that the near plane may use. */
const USED = 0.8;

/**
 * Distance of the near plane, whose corners lie within the clearance of the camera; millimetres.
 *
 * `difference` is the distance of the shown walls from the walls to which the clearance refers.
 */
export function nearPlane(clearance: number, difference: number, aspect: number): number {
  const slope = Math.tan((FLIGHT_FIELD * Math.PI) / 360);
  const corner = Math.hypot(1, slope, slope * aspect);
  return Math.max(NEAREST, Math.min(FARTHEST, (USED * (clearance - difference)) / corner));
}

export class FlightCamera {
  /** Turn of the head from the direction of the flight, degrees. */
  readonly look = { yaw: 0, pitch: 0 };
  readonly #tube: Tube;
  readonly #axis = new Vector3();
  readonly #direction = new Vector3();

  constructor(tube: Tube) {
    this.#tube = tube;
  }

  /** Places the camera; `place` is in millimetres along the tube. */
  place(camera: PerspectiveCamera, way: Way, place: number): void {
    const { course } = this.#tube;
    const { position, up } = camera;
    const [axis, direction] = [this.#axis.set(0, 0, 1), this.#direction];
    way.at(place, position);
    way.ahead(place, direction);
    direction.normalize();
    if (course) {
      course.turn(0, 0, 1, place, axis);
      // The vertical of the picture is y of the cross section.
      course.turn(0, 1, 0, place, up);
    }
    const along = direction.dot(axis);
    if (along < LEAST_ALONG) direction.addScaledVector(axis, LEAST_ALONG - along);
    camera.lookAt(direction.add(position));
    up.set(0, 1, 0);
    camera.rotateY((this.look.yaw * Math.PI) / 180);
    camera.rotateX((this.look.pitch * Math.PI) / 180);
  }

  turn(right: number, down: number): void {
    this.look.yaw += right;
    this.look.pitch = Math.max(-85, Math.min(85, this.look.pitch + down));
  }

  /** Looks straight ahead. */
  straighten(): void {
    this.look.yaw = this.look.pitch = 0;
  }
}
