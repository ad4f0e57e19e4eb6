// Lines in a plane as thin bands, which are drawn faster than wide lines.
import { BufferAttribute, BufferGeometry, DoubleSide, DynamicDrawUsage, Mesh, MeshBasicMaterial, Vector3, type ColorRepresentation, type Plane } from "three";
import type { Course } from "../course.ts";
import { BENT } from "./clipping.ts";
import { Segments } from "./outline.ts";

export class Ribbons {
  readonly segments: Segments;
  readonly object: Mesh<BufferGeometry, MeshBasicMaterial>;
  readonly #half: number;
  readonly #course: Course | undefined;
  #room = 0;

  /** `width` is in millimetres. With a course, the lines belong to a bent tube. */
  constructor(color: ColorRepresentation, width: number, course?: Course) {
    this.#half = width / 2;
    this.#course = course;
    this.segments = new Segments(course !== undefined);
    this.object = new Mesh(new BufferGeometry(), new MeshBasicMaterial({ color, side: DoubleSide }));
    if (course) this.object.material.defines = BENT;
    this.object.frustumCulled = false;
    this.object.renderOrder = 3;
    this.object.visible = false;
  }

  /** Shows the content of `segments`, in planes of the straight tube with this unit normal. */
  update(plane: { nx: number; ny: number; nz: number }): void {
    const { points, straight, count } = this.segments;
    let { nx, ny, nz } = plane;
    this.object.visible = count > 0;
    if (count === 0) return;
    if (count > this.#room) this.#grow(points.length / 6);
    const position = this.object.geometry.getAttribute("position") as BufferAttribute;
    const corners = position.array;
    const places = this.#course && (this.object.geometry.getAttribute("straight") as BufferAttribute);
    const normal = new Vector3();
    for (let k = 0; k < count; k++) {
      const [from, to] = [6 * k, 12 * k];
      const dx = points[from + 3]! - points[from]!;
      const dy = points[from + 4]! - points[from + 1]!;
      const dz = points[from + 5]! - points[from + 2]!;
      if (places) {
        this.#course!.turn(plane.nx, plane.ny, plane.nz, straight[from + 2]!, normal);
        ({ x: nx, y: ny, z: nz } = normal);
        // Both corners of an end have the same place.
        for (let i = 0; i < 12; i++) places.array[to + i] = straight[from + 3 * Math.floor(i / 6) + (i % 3)]!;
      }
      const scale = this.#half / (Math.hypot(dx, dy, dz) || 1);
      const sx = (ny * dz - nz * dy) * scale;
      const sy = (nz * dx - nx * dz) * scale;
      const sz = (nx * dy - ny * dx) * scale;
      for (let end = 0; end < 2; end++) {
        for (let side = 0; side < 2; side++) {
          const at = to + 6 * end + 3 * side;
          const sign = side === 0 ? 1 : -1;
          corners[at] = points[from + 3 * end]! + sign * sx;
          corners[at + 1] = points[from + 3 * end + 1]! + sign * sy;
          corners[at + 2] = points[from + 3 * end + 2]! + sign * sz;
        }
      }
    }
    position.needsUpdate = true;
    if (places) places.needsUpdate = true;
    this.object.geometry.setDrawRange(0, 6 * count);
  }

  clip(planes: Plane[]): void {
    this.object.material.clippingPlanes = planes;
  }

  dispose(): void {
    this.object.geometry.dispose();
    this.object.material.dispose();
  }

  #grow(room: number): void {
    this.#room = room;
    const index = new Uint32Array(6 * room);
    for (let k = 0; k < room; k++) {
      const v = 4 * k;
      index.set([v, v + 1, v + 2, v + 2, v + 1, v + 3], 6 * k);
    }
    this.object.geometry.dispose();
    this.object.geometry.setAttribute("position", new BufferAttribute(new Float32Array(12 * room), 3).setUsage(DynamicDrawUsage));
    if (this.#course) this.object.geometry.setAttribute("straight", new BufferAttribute(new Float32Array(12 * room), 3).setUsage(DynamicDrawUsage));
    this.object.geometry.setIndex(new BufferAttribute(index, 1));
  }
}
