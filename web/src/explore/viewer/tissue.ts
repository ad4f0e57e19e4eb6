// The walls and caps of a tube as three.js meshes.
import { BufferAttribute, BufferGeometry, DoubleSide, DynamicDrawUsage, FrontSide, Group, Mesh, type Plane } from "three";
import type { PatchGroup, View } from "../view.ts";
import { mucosaLight } from "./occlusion.ts";
import type { CutPlane } from "./outline.ts";
import { select, type Stretch } from "./sight.ts";
import { PATCH_NAMES, type Patch, type PatchName, type Surface } from "./surface.ts";
import { TissueMaterial } from "./tissue-material.ts";

/** Colour of cut tissue, as in the service's drawings. */
export const TISSUE = 0xde95a9;

// Caps look like cut faces.
const COLORS: Record<PatchName, number> = { inner_wall: 0xd0718a, outer_wall: 0xe3ab9c, cap_isthmus: TISSUE, cap_ampulla: TISSUE };
const GROUPS: Record<PatchName, PatchGroup> = { inner_wall: "inner", outer_wall: "outer", cap_isthmus: "caps", cap_ampulla: "caps" };
const GLASS = 0.28;

interface Drawn {
  patch: Patch;
  geometry: BufferGeometry;
  /** All triangles, and the triangles of the last limited picture. */
  all: BufferAttribute;
  part: BufferAttribute | undefined;
}

export class Tissue {
  readonly group = new Group();
  surface: Surface | undefined;
  readonly #bent: boolean;
  readonly #materials = new Map<PatchName, TissueMaterial>();
  #drawn: Drawn[] = [];
  /** Limits within which the patches are drawn; undefined for all triangles. */
  #limits: (Stretch & { planes: readonly CutPlane[]; everywhere: boolean }) | undefined;
  #visible: Record<PatchGroup, boolean> = { inner: true, outer: true, caps: true };

  constructor(bent: boolean) {
    this.#bent = bent;
  }

  /** Replaces the surface; returns the geometries of its patches. */
  show(surface: Surface, length: number): BufferGeometry[] {
    this.#clear();
    this.surface = surface;
    return surface.patches.map((patch) => {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(patch.positions, 3));
      if (this.#bent) geometry.setAttribute("straight", new BufferAttribute(patch.straight, 3));
      geometry.setAttribute("normal", new BufferAttribute(patch.normals, 3, true));
      const all = new BufferAttribute(patch.index, 1);
      geometry.setIndex(all);
      this.#drawn.push({ patch, geometry, all, part: undefined });
      if (patch.name === "inner_wall") geometry.setAttribute("openness", new BufferAttribute(mucosaLight(patch, length), 1, true));
      const mesh = new Mesh(geometry, this.#material(patch.name));
      mesh.name = patch.name;
      // The mesh is nearly always in the picture.
      mesh.frustumCulled = false;
      // Draw the meshes that hide much first.
      mesh.renderOrder = patch.name === "inner_wall" ? 4 : 2;
      mesh.visible = this.isVisible(patch);
      this.group.add(mesh);
      return geometry;
    });
  }

  /** Updates the meshes after the arrays of the surface have changed. */
  moved(): void {
    this.unlimit();
    for (const { geometry } of this.#drawn) {
      for (const name of ["position", "straight", "normal"]) {
        const attribute = geometry.attributes[name];
        if (attribute) attribute.needsUpdate = true;
      }
    }
  }

  isVisible(patch: Patch): boolean {
    return this.#visible[GROUPS[patch.name]];
  }

  /**
   * Applies the shown patches, with back faces in the colours of `cuts`; subscribes the calling
   * effect.
   */
  apply(view: View, planes: Plane[], cuts: readonly number[] | undefined): void {
    this.#visible = { inner: view.shown.inner.value, outer: view.shown.outer.value, caps: view.shown.caps.value };
    for (const mesh of this.group.children) mesh.visible = this.#visible[GROUPS[mesh.name as PatchName]];
    // While the tissue is closed, its inside is not visible.
    const side = view.closed && cuts === undefined ? FrontSide : DoubleSide;
    for (const name of PATCH_NAMES) {
      const material = this.#material(name);
      material.cuts = cuts;
      material.clippingPlanes = planes;
      if (material.side !== side) material.needsUpdate = true;
      material.side = side;
    }
    this.#material("outer_wall").glass = view.translucent.value ? GLASS : 1;
  }

  /**
   * Draws only triangles that are neither wholly behind a plane nor outside a stretch of the tube.
   *
   * Unless `everywhere` is set, the whole outer wall is drawn outside the stretch.
   */
  limit(planes: readonly CutPlane[], { from, to }: Stretch, everywhere: boolean): void {
    const limits = this.#limits;
    if (limits?.planes === planes && limits.from === from && limits.to === to && limits.everywhere === everywhere) return;
    this.#limits = { planes, from, to, everywhere };
    const within = [...planes, { nx: 0, ny: 0, nz: 1, d: -from }, { nx: 0, ny: 0, nz: -1, d: to }];
    for (const drawn of this.#drawn) {
      const { patch, geometry } = drawn;
      const part = (drawn.part ??= new BufferAttribute(patch.index.slice(), 1).setUsage(DynamicDrawUsage));
      const count = select(patch, patch.name === "outer_wall" && !everywhere ? planes : within, part.array as typeof patch.index);
      part.clearUpdateRanges();
      part.addUpdateRange(0, count);
      part.needsUpdate = true;
      geometry.setIndex(part);
      geometry.setDrawRange(0, count);
    }
  }

  /** Draws all triangles. */
  unlimit(): void {
    if (!this.#limits) return;
    this.#limits = undefined;
    for (const { geometry, all } of this.#drawn) {
      geometry.setIndex(all);
      geometry.setDrawRange(0, Infinity);
    }
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
    this.surface = this.#limits = undefined;
    this.#drawn = [];
  }

  #material(name: PatchName): TissueMaterial {
    let material = this.#materials.get(name);
    if (!material) {
      material = new TissueMaterial(COLORS[name], { lit: GROUPS[name] !== "caps", occluded: name === "inner_wall", bent: this.#bent });
      this.#materials.set(name, material);
    }
    return material;
  }
}
