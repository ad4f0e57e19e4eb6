// Lines in a plane as thin bands, which are drawn faster than lines of a width.
import { BufferAttribute, BufferGeometry, DoubleSide, DynamicDrawUsage, Mesh, MeshBasicMaterial, type ColorRepresentation, type Plane } from "three";
import { Segments } from "./outline.ts";

export class Ribbons {
  readonly segments = new Segments();
  readonly object: Mesh<BufferGeometry, MeshBasicMaterial>;
  readonly #half: number;
  #room = 0;

  /** The width is in millimetres. */
  constructor(color: ColorRepresentation, width: number) {
    this.#half = width / 2;
    this.object = new Mesh(new BufferGeometry(), new MeshBasicMaterial({ color, side: DoubleSide }));
    this.object.frustumCulled = false;
    this.object.renderOrder = 3;
    this.object.visible = false;
  }

  /** Shows what `segments` holds now, in planes with this normal (of length 1). */
  update({ nx, ny, nz }: { nx: number; ny: number; nz: number }): void {
    const { points, count } = this.segments;
    this.object.visible = count > 0;
    if (count === 0) return;
    if (count > this.#room) this.#grow(points.length / 6);
    const position = this.object.geometry.getAttribute("position") as BufferAttribute;
    const corners = position.array;
    for (let k = 0; k < count; k++) {
      const [from, to] = [6 * k, 12 * k];
      const dx = points[from + 3]! - points[from]!;
      const dy = points[from + 4]! - points[from + 1]!;
      const dz = points[from + 5]! - points[from + 2]!;
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
    this.object.geometry.setIndex(new BufferAttribute(index, 1));
  }
}
