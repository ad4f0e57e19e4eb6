// Planes that cut the tube open, with closed cut faces.
//
// A face is drawn where an odd number of triangles of the closed surface lies along the line of
// sight behind the plane: each triangle inverts the plane's bit of the stencil. This is exact for a
// surface that does not intersect itself.
//
// Coarse pictures avoid counting. A back face of the closed surface is visible only where the line
// of sight enters tissue through a cut. The walls therefore draw their back faces in the colour of
// the cut. Thin triangles leave a few wrong pixels. Where two cuts intersect, the tissue may be
// transparent from behind one of them.
//
// Planes cut the straight tube. In a bent tube they follow its course, so their faces are not
// planes and are built from triangles.
import {
  AlwaysStencilFunc,
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  EqualStencilFunc,
  Group,
  InvertStencilOp,
  KeepStencilOp,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  Plane,
  PlaneGeometry,
  Vector3,
} from "three";
import type { Course } from "../course.ts";
import type { Tube } from "../framing.ts";
import type { View } from "../view.ts";
import { BENT } from "./clipping.ts";
import { fill, type Direction, type Face } from "./fill.ts";
import { addOutline, type CutPlane } from "./outline.ts";
import { Ribbons } from "./ribbons.ts";
import type { Stretch } from "./sight.ts";
import type { Surface } from "./surface.ts";
import { TISSUE } from "./tissue.ts";

/**
 * Edges of cut faces, as in the service's drawings; millimetres, about as wide as an epithelium.
 */
const [MUCOSA, MUCOSA_WIDTH] = [0x7d3a78, 0.012];
const [OUTSIDE, OUTSIDE_WIDTH] = [0xa9607a, 0.008];

/** Colour of faces along the tube, different from faces across it. */
const SHADED_TISSUE = 0xd2879c;

/**
 * Distance of the rims of the end caps from the ends in millimetres, so that the plane crosses the
 * walls.
 */
const RIM = 1e-4;

class Cut {
  readonly plane = new Plane();
  readonly group = new Group();
  readonly color: number;
  readonly #counting: MeshBasicMaterial;
  readonly #face: Mesh<BufferGeometry, MeshBasicMaterial>;
  readonly #counters = new Group();
  readonly #edges: Edges;
  readonly #course: Course | undefined;
  /** The axes across the tube and, for a lengthwise cut, along it. */
  readonly #axes = [new Vector3(), new Vector3()] as const;
  #filled: Face | undefined;
  /** The surface and plane of the current edges. */
  #drawn: { surface: Surface; plane: Plane } | undefined;

  constructor(bit: number, color: number, course: Course | undefined) {
    this.color = color;
    this.#course = course;
    this.#edges = new Edges(course);
    this.#counting = new MeshBasicMaterial({
      side: DoubleSide,
      colorWrite: false,
      depthWrite: false,
      depthTest: false,
      stencilWrite: true,
      stencilWriteMask: bit,
      stencilFunc: AlwaysStencilFunc,
      stencilZPass: InvertStencilOp,
      clippingPlanes: [this.plane],
    });
    const material = new MeshBasicMaterial({
      color,
      side: DoubleSide,
      stencilWrite: !course,
      stencilWriteMask: 0,
      stencilFuncMask: bit,
      stencilRef: bit,
      stencilFunc: EqualStencilFunc,
      stencilZPass: KeepStencilOp,
      // The outlines lie in the plane of the face.
      polygonOffset: true,
      polygonOffsetFactor: 1,
      polygonOffsetUnits: 2,
    });
    if (course) material.defines = BENT;
    this.#face = new Mesh(course ? new BufferGeometry() : new PlaneGeometry(1, 1), material);
    this.#face.renderOrder = 2;
    this.#face.matrixAutoUpdate = false;
    if (course) this.#face.frustumCulled = false;
    this.group.add(this.#counters, this.#face, this.#edges.group);
    this.group.visible = false;
  }

  count(geometries: readonly BufferGeometry[]): void {
    this.#counters.clear();
    if (this.#course) return;
    for (const geometry of geometries) {
      const counter = new Mesh(geometry, this.#counting);
      counter.renderOrder = 1;
      counter.frustumCulled = false;
      this.#counters.add(counter);
    }
  }

  place(normal: Vector3, point: Vector3, face: Matrix4): void {
    this.plane.setFromNormalAndCoplanarPoint(normal, point);
    this.#axes[0].setFromMatrixColumn(face, 0).normalize();
    this.#axes[1].setFromMatrixColumn(face, 1).normalize();
    if (this.#course) return;
    this.#face.matrix.copy(face);
    this.#face.matrixWorldNeedsUpdate = true;
  }

  /**
   * Updates the face. `counted` faces and faces of bent tubes are drawn here, others by the walls.
   */
  update(on: boolean, surface: Surface | undefined, others: Plane[], counted: boolean): void {
    this.group.visible = on && surface !== undefined;
    if (!on || !surface) return;
    this.#counters.visible = counted;
    this.#face.visible = counted || this.#course !== undefined;
    this.#face.material.clippingPlanes = others;
    if (this.#drawn?.surface !== surface || !this.#drawn.plane.equals(this.plane)) {
      this.#edges.trace(surface, [cutPlane(this.plane)]);
      this.#drawn = { surface, plane: this.plane.clone() };
      if (this.#course) this.#fill();
    }
    this.#edges.clip(others);
  }

  #fill(): void {
    this.#filled = this.#edges.fill(this.#axes[0].toArray(), this.#axes[1].toArray());
    const { positions, straight, index } = this.#filled;
    // Buffers cannot change their size, so create another geometry.
    this.#face.geometry.dispose();
    this.#face.geometry = new BufferGeometry()
      .setAttribute("position", new BufferAttribute(positions, 3))
      .setAttribute("straight", new BufferAttribute(straight, 3))
      .setIndex(new BufferAttribute(index, 1));
  }

  /** The face in a bent tube, if it is in use. */
  get face(): Face | undefined {
    return this.group.visible ? this.#filled : undefined;
  }

  /** Shows or hides the edges of the face. */
  set edged(on: boolean) {
    this.#edges.group.visible = on;
  }

  dispose(): void {
    this.#counting.dispose();
    this.#face.geometry.dispose();
    this.#face.material.dispose();
    this.#edges.dispose();
  }
}

/** Intersections of the walls with planes. */
class Edges {
  readonly group = new Group();
  readonly #mucosa: Ribbons;
  readonly #outside: Ribbons;

  constructor(course: Course | undefined) {
    this.#mucosa = new Ribbons(MUCOSA, MUCOSA_WIDTH, course);
    this.#outside = new Ribbons(OUTSIDE, OUTSIDE_WIDTH, course);
    this.group.add(this.#mucosa.object, this.#outside.object);
  }

  /** Traces the edges with parallel planes. */
  trace(surface: Surface, planes: readonly [CutPlane, ...CutPlane[]]): void {
    this.#mucosa.segments.clear();
    this.#outside.segments.clear();
    for (const patch of surface.patches) {
      const ribbons = { inner_wall: this.#mucosa, outer_wall: this.#outside, cap_isthmus: undefined, cap_ampulla: undefined }[patch.name];
      for (const plane of planes) if (ribbons) addOutline(patch, plane, ribbons.segments);
    }
    this.#mucosa.update(planes[0]);
    this.#outside.update(planes[0]);
  }

  /** The face between the edges of one plane. */
  fill(right: Direction, up: Direction): Face {
    return fill([this.#mucosa.segments, this.#outside.segments], right, up);
  }

  clip(planes: Plane[]): void {
    this.#mucosa.clip(planes);
    this.#outside.clip(planes);
  }

  dispose(): void {
    this.#mucosa.dispose();
    this.#outside.dispose();
  }
}

export class Cuts {
  readonly group = new Group();
  readonly #lengthwise: Cut;
  readonly #across: Cut;
  /** Rims of the caps at the ends. */
  readonly #rims: Edges;
  readonly #tube: Tube;
  /** Planes in use. */
  active: Plane[] = [];
  planes: readonly CutPlane[] = [];
  /** The part of the tube that the cut across leaves. */
  readonly kept: Stretch;
  /** Colours of the cuts in use, if back faces of the tissue show them. */
  backs: number[] | undefined;
  /** True if rims are shown where they are wide enough. */
  #rimmed = true;

  constructor(tube: Tube) {
    this.#tube = tube;
    this.#lengthwise = new Cut(1, SHADED_TISSUE, tube.course);
    this.#across = new Cut(2, TISSUE, tube.course);
    this.#rims = new Edges(tube.course);
    this.kept = { from: 0, to: tube.length };
    this.group.add(this.#lengthwise.group, this.#across.group, this.#rims.group);
  }

  /** Sets a surface and the geometries of its patches. */
  show(surface: Surface, geometries: readonly BufferGeometry[]): void {
    this.#lengthwise.count(geometries);
    this.#across.count(geometries);
    const plane = (z: number) => ({ nx: 0, ny: 0, nz: 1, d: -z });
    this.#rims.trace(surface, [plane(RIM), plane(this.#tube.length - RIM)]);
  }

  /** Applies the cuts of a view for a coarse or a full picture; subscribes the calling effect. */
  apply(view: View, surface: Surface | undefined, coarse: boolean): void {
    const outside = !view.flying.value;
    const [lengthwise, across] = [view.lengthwise.value && outside, view.across.value && outside];
    this.#place(view);
    const cuts = [...(lengthwise ? [this.#lengthwise] : []), ...(across ? [this.#across] : [])];
    this.active = cuts.map(({ plane }) => plane);
    this.planes = this.active.map(cutPlane);
    const at = view.position.value * this.#tube.length;
    this.kept.from = across && view.flipped.value ? at : 0;
    this.kept.to = across && !view.flipped.value ? at : this.#tube.length;
    // Without its face, the cut does not hide the plane of a section.
    const counted = !coarse || !view.closed || view.plane.value;
    // Between triangles of a bent tube's face, single pixels may show the content behind it.
    const seen = cuts.length > 0 && (!counted || (this.#tube.course !== undefined && view.closed));
    this.backs = seen ? cuts.map(({ color }) => color) : undefined;
    this.#rims.clip(this.active);
    this.#rimmed = outside && view.shown.caps.value;
    this.#lengthwise.update(lengthwise, surface, across ? [this.#across.plane] : [], counted);
    this.#across.update(across, surface, lengthwise ? [this.#lengthwise.plane] : [], counted);
  }

  /** Shows or hides edges of faces and rims, which are too thin from far away. */
  set edged(on: boolean) {
    this.#rims.group.visible = on && this.#rimmed;
    this.#lengthwise.edged = on;
    this.#across.edged = on;
  }

  /** The faces of the cuts in a bent tube. */
  get faces(): Face[] {
    return [this.#lengthwise.face, this.#across.face].filter((face) => face !== undefined);
  }

  /** True if the tube is cut lengthwise and the eye is on the open side. */
  opensTo(eye: Vector3): boolean {
    return this.#lengthwise.group.visible && this.#lengthwise.plane.distanceToPoint(eye) < 0;
  }

  dispose(): void {
    this.#lengthwise.dispose();
    this.#across.dispose();
    this.#rims.dispose();
  }

  #place(view: View): void {
    const { length, radius, x, y } = this.#tube;
    const angle = (view.angle.value * Math.PI) / 180;
    const normal = new Vector3(Math.cos(angle), Math.sin(angle), 0);
    const middle = new Vector3(x, y, length / 2);
    const side = new Vector3(normal.y, -normal.x, 0);
    const along = new Vector3(0, 0, 1);
    this.#lengthwise.place(
      normal,
      middle,
      new Matrix4().makeBasis(side.multiplyScalar(2.2 * radius), along.clone().multiplyScalar(1.01 * length), normal.clone().negate()).setPosition(middle),
    );
    const at = new Vector3(x, y, view.position.value * length);
    this.#across.place(
      along.multiplyScalar(view.flipped.value ? 1 : -1),
      at,
      new Matrix4().makeScale(2.2 * radius, 2.2 * radius, 1).setPosition(at),
    );
  }
}

function cutPlane({ normal, constant }: Plane): CutPlane {
  return { nx: normal.x, ny: normal.y, nz: normal.z, d: constant };
}
