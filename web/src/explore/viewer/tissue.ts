// The walls and caps of a tube as three.js meshes.
import { BufferAttribute, BufferGeometry, DoubleSide, FrontSide, Group, Mesh, MeshBasicMaterial, MeshLambertMaterial, type Plane, type WebGLProgramParametersWithUniforms } from "three";
import type { PatchGroup, View } from "../view.ts";
import { mucosaLight } from "./occlusion.ts";
import type { Patch, PatchName, Surface } from "./surface.ts";

/** Cut tissue, as in the service's drawings. */
export const TISSUE = 0xde95a9;

const COLORS: Record<PatchName, number> = { inner_wall: 0xd0718a, outer_wall: 0xe3ab9c, cap_isthmus: TISSUE, cap_ampulla: TISSUE };
const GROUPS: Record<PatchName, PatchGroup> = { inner_wall: "inner", outer_wall: "outer", cap_isthmus: "caps", cap_ampulla: "caps" };
const GLASS = 0.28;

export class Tissue {
  readonly group = new Group();
  /** Strength of the rings on the mucosa that show the way covered in flight: 0 or 1. */
  readonly rings = { value: 0 };
  surface: Surface | undefined;
  readonly #materials = new Map<PatchName, MeshBasicMaterial | MeshLambertMaterial>();
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
      if (patch.name === "inner_wall") geometry.setAttribute("color", grey(mucosaLight(patch, length)));
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

  /** Applies what is shown; subscribes the effect that calls it. */
  apply(view: View, planes: Plane[]): void {
    this.#visible = { inner: view.shown.inner.value, outer: view.shown.outer.value, caps: view.shown.caps.value };
    for (const mesh of this.group.children) mesh.visible = this.#visible[GROUPS[mesh.name as PatchName]];
    const glass = view.translucent.value;
    const outer = this.#material("outer_wall");
    outer.transparent = glass;
    outer.opacity = glass ? GLASS : 1;
    outer.depthWrite = !glass;
    // Nothing is seen from within the tissue while it is closed.
    const side = this.#visible.outer && this.#visible.caps && !glass ? FrontSide : DoubleSide;
    for (const name of Object.keys(COLORS) as PatchName[]) {
      const material = this.#material(name);
      material.clippingPlanes = planes;
      if (material.side !== side) material.needsUpdate = true;
      material.side = side;
    }
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

  #material(name: PatchName): MeshBasicMaterial | MeshLambertMaterial {
    let material = this.#materials.get(name);
    if (!material) this.#materials.set(name, (material = newMaterial(name, this.rings)));
    return material;
  }
}

/** Caps look like cut faces, in the colour of the service's drawings whatever the light. */
function newMaterial(name: PatchName, rings: { value: number }): MeshBasicMaterial | MeshLambertMaterial {
  const color = COLORS[name];
  if (GROUPS[name] === "caps") return new MeshBasicMaterial({ color });
  const material = new MeshLambertMaterial({ color, vertexColors: name === "inner_wall" });
  if (name === "inner_wall") material.onBeforeCompile = (shader) => addRings(shader, rings);
  return material;
}

/** Rings around the lumen, every 0.1 mm and stronger every millimetre, fading where they would be dense. */
function addRings(shader: WebGLProgramParametersWithUniforms, rings: { value: number }): void {
  shader.uniforms["rings"] = rings;
  shader.vertexShader = shader.vertexShader
    .replace("#include <common>", "#include <common>\nvarying float along;")
    .replace("#include <begin_vertex>", "#include <begin_vertex>\nalong = position.z;");
  shader.fragmentShader = shader.fragmentShader
    .replace("#include <common>", `#include <common>
      uniform float rings;
      varying float along;
      float ring(float spacing, float width) {
        float blur = fwidth(along);
        float distance = abs(fract(along / spacing + 0.5) - 0.5) * spacing;
        return (1.0 - smoothstep(width - blur, width + blur, distance)) * clamp(1.0 - 4.0 * blur / spacing, 0.0, 1.0);
      }`)
    .replace("#include <color_fragment>", `#include <color_fragment>
      if (rings > 0.0) diffuseColor.rgb *= 1.0 - rings * max(0.28 * ring(0.1, 0.0012), 0.6 * ring(1.0, 0.004));`);
}

function grey(light: Uint8Array<ArrayBuffer>): BufferAttribute {
  const colors = new Uint8Array(3 * light.length);
  for (let i = 0; i < light.length; i++) colors.fill(light[i]!, 3 * i, 3 * i + 3);
  return new BufferAttribute(colors, 3, true);
}
