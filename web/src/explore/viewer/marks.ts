// What is drawn into the scene besides the tube: the plane of a section, and a measured distance.
import { BufferAttribute, BufferGeometry, DoubleSide, Group, Mesh, MeshBasicMaterial, PlaneGeometry, Points, PointsMaterial } from "three";
import type { Tube } from "../framing.ts";
import type { Spot } from "../measure.ts";
import { Lines } from "./lines.ts";
import type { Segments } from "./outline.ts";

const FRAME = 1.15;

export class Marks {
  readonly group = new Group();
  readonly #plane: Mesh<PlaneGeometry, MeshBasicMaterial>;
  readonly #frame = new Lines({ color: 0xffffff, width: 2 });
  readonly #distance = new Lines({ color: 0xffffff, width: 2.5, over: true });
  readonly #ends: Points<BufferGeometry, PointsMaterial>;
  readonly #tube: Tube;

  constructor(tube: Tube) {
    this.#tube = tube;
    const size = 2 * FRAME * tube.radius;
    const glass = new MeshBasicMaterial({ transparent: true, opacity: 0.18, side: DoubleSide, depthWrite: false, fog: false });
    this.#plane = new Mesh(new PlaneGeometry(size, size), glass);
    this.#plane.renderOrder = 5;
    const points = new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(6), 3));
    this.#ends = new Points(points, new PointsMaterial({ size: 9, sizeAttenuation: false, depthTest: false, transparent: true, fog: false }));
    this.#ends.frustumCulled = false;
    this.#ends.renderOrder = 11;
    this.group.add(this.#plane, this.#frame.object, this.#distance.object, this.#ends);
    this.#plane.visible = this.#ends.visible = false;
  }

  set color(color: string) {
    this.#plane.material.color.set(color);
    this.#frame.color = color;
    this.#distance.color = color;
    this.#ends.material.color.set(color);
  }

  /** Shows the plane at `z` millimetres; undefined hides it. */
  setPlane(z: number | undefined): void {
    this.#plane.visible = z !== undefined;
    this.#frame.segments.clear();
    if (z !== undefined) {
      const { x, y, radius } = this.#tube;
      const r = FRAME * radius;
      this.#plane.position.set(x, y, z);
      segment(this.#frame.segments, x - r, y - r, z, x + r, y - r, z);
      segment(this.#frame.segments, x + r, y - r, z, x + r, y + r, z);
      segment(this.#frame.segments, x + r, y + r, z, x - r, y + r, z);
      segment(this.#frame.segments, x - r, y + r, z, x - r, y - r, z);
    }
    this.#frame.update();
  }

  /** Shows up to two points, and the line between them. */
  setDistance(a: Spot | undefined, b: Spot | undefined): void {
    const position = this.#ends.geometry.getAttribute("position");
    const spots = [a, b].filter((spot) => spot !== undefined);
    spots.forEach((spot, i) => position.setXYZ(i, spot.x, spot.y, spot.z));
    position.needsUpdate = true;
    this.#ends.geometry.setDrawRange(0, spots.length);
    this.#ends.visible = spots.length > 0;
    this.#distance.segments.clear();
    if (a && b) segment(this.#distance.segments, a.x, a.y, a.z, b.x, b.y, b.z);
    this.#distance.update();
  }

  dispose(): void {
    this.#plane.geometry.dispose();
    this.#plane.material.dispose();
    this.#frame.dispose();
    this.#distance.dispose();
    this.#ends.geometry.dispose();
    this.#ends.material.dispose();
  }
}

function segment(segments: Segments, ...ends: [number, number, number, number, number, number]): void {
  const at = segments.next();
  segments.points.set(ends, at);
}
