// The walls and caps of a tube as three.js meshes.
import { BufferAttribute, BufferGeometry, DoubleSide, FrontSide, Group, Mesh, type Plane } from "three";
import type { PatchGroup, View } from "../view.ts";
import { mucosaLight } from "./occlusion.ts";
import { PATCH_NAMES, type Patch, type PatchName, type Surface } from "./surface.ts";
import { TissueMaterial } from "./tissue-material.ts";

/** Cut tissue, as in the service's drawings. */
export const TISSUE = 0xde95a9;

// Caps look like cut faces.
const COLORS: Record<PatchName, number> = { inner_wall: 0xd0718a, outer_wall: 0xe3ab9c, cap_isthmus: TISSUE, cap_ampulla: TISSUE };
const GROUPS: Record<PatchName, PatchGroup> = { inner_wall: "inner", outer_wall: "outer", cap_isthmus: "caps", cap_ampulla: "caps" };
const GLASS = 0.28;

export class Tissue {
  readonly group = new Group();
  surface: Surface | undefined;
  readonly #materials = new Map<PatchName, TissueMaterial>();
  #visible: Record<PatchGroup, boolean> = { inner: true, outer: true, caps: true };

  /** Takes over a surface in place of the present one; returns its geometries. */
  show(surface: Surface, length: number): BufferGeometry[] {
    this.#clear();
    this.surface = surface;
    return surface.patches.map((patch) => {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(patch.positions, 3));
      geometry.setAttribute("normal", new BufferAttribute(patch.normals, 3, true));
      geometry.setIndex(new BufferAttribute(patch.index, 1));
      if (patch.name === "inner_wall") geometry.setAttribute("openness", new BufferAttribute(mucosaLight(patch, length), 1, true));
      const mesh = new Mesh(geometry, this.#material(patch.name));
      mesh.name = patch.name;
      // It is nearly always in the picture.
      mesh.frustumCulled = false;
      // What hides much is drawn first.
      mesh.renderOrder = patch.name === "inner_wall" ? 4 : 2;
      mesh.visible = this.isVisible(patch);
      this.group.add(mesh);
      return geometry;
    });
  }

  isVisible(patch: Patch): boolean {
    return this.#visible[GROUPS[patch.name]];
  }

  /** Applies what is shown, with back faces of the colour of a cut if there is one; subscribes the effect that calls it. */
  apply(view: View, planes: Plane[], cut: number | undefined): void {
    this.#visible = { inner: view.shown.inner.value, outer: view.shown.outer.value, caps: view.shown.caps.value };
    for (const mesh of this.group.children) mesh.visible = this.#visible[GROUPS[mesh.name as PatchName]];
    // Nothing is seen from within the tissue while it is closed.
    const side = view.closed && cut === undefined ? FrontSide : DoubleSide;
    for (const name of PATCH_NAMES) {
      const material = this.#material(name);
      material.cut = cut;
      material.clippingPlanes = planes;
      if (material.side !== side) material.needsUpdate = true;
      material.side = side;
    }
    this.#material("outer_wall").glass = view.translucent.value ? GLASS : 1;
  }

  set flight(on: boolean) {
    for (const name of PATCH_NAMES) this.#material(name).flight = on;
  }

  dispose(): void {
    this.#clear();
    for (const material of this.#materials.values()) material.dispose();
  }

  #clear(): void {
    for (const mesh of this.group.children) (mesh as Mesh).geometry.dispose();
    this.group.clear();
    this.surface = undefined;
  }

  #material(name: PatchName): TissueMaterial {
    let material = this.#materials.get(name);
    if (!material) this.#materials.set(name, (material = new TissueMaterial(COLORS[name], { lit: GROUPS[name] !== "caps", occluded: name === "inner_wall" })));
    return material;
  }
}
