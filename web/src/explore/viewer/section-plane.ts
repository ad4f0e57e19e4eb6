// The plane of a section in the scene.
import { DoubleSide, Group, Mesh, MeshBasicMaterial, PlaneGeometry, Vector3 } from "three";
import type { Tube } from "../framing.ts";
import { Ribbons } from "./ribbons.ts";

/** Half of the plane's side, as a multiple of the tube's radius. */
const SIZE = 1.15;
const BORDER = 0.03;

export class SectionPlane {
  readonly group = new Group();
  readonly #glass: Mesh<PlaneGeometry, MeshBasicMaterial>;
  readonly #border = new Ribbons(0xffffff, BORDER);
  readonly #tube: Tube;

  constructor(tube: Tube) {
    this.#tube = tube;
    const { x, y, radius } = tube;
    const r = SIZE * radius;
    const material = new MeshBasicMaterial({ transparent: true, opacity: 0.18, side: DoubleSide, depthWrite: false });
    this.#glass = new Mesh(new PlaneGeometry(2 * r, 2 * r), material);
    this.#glass.renderOrder = 5;
    const corners = [-r, -r, r, -r, r, r, -r, r] as const;
    const { segments } = this.#border;
    for (let i = 0; i < 8; i += 2) {
      segments.points.set([corners[i]!, corners[i + 1]!, 0, corners[(i + 2) % 8]!, corners[(i + 3) % 8]!, 0], segments.next());
    }
    this.#border.update({ nx: 0, ny: 0, nz: 1 });
    this.group.position.set(x, y, 0);
    this.group.matrixAutoUpdate = false;
    this.group.add(this.#glass, this.#border.object);
  }

  set color(color: string) {
    this.#glass.material.color.set(color);
    this.#border.object.material.color.set(color);
  }

  /** Shows the plane across the tube at `z` millimetres; undefined hides it. */
  place(z: number | undefined): void {
    this.group.visible = z !== undefined;
    if (z === undefined) return;
    const { course } = this.#tube;
    if (course) {
      const [u, v, tangent, at] = [new Vector3(), new Vector3(), new Vector3(), new Vector3()];
      course.turn(1, 0, 0, z, u);
      course.turn(0, 1, 0, z, v);
      course.turn(0, 0, 1, z, tangent);
      course.bend(0, 0, z, at);
      this.group.matrix.makeBasis(u, v, tangent).setPosition(at);
      this.group.matrixWorldNeedsUpdate = true;
      return;
    }
    this.group.position.z = z;
    this.group.updateMatrix();
  }

  dispose(): void {
    this.#glass.geometry.dispose();
    this.#glass.material.dispose();
    this.#border.dispose();
  }
}
