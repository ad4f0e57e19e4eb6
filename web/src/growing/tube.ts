// The growing tube in 3D: a stack of its sections inside a translucent outer wall, seen from the
// ampulla.
import {
  BufferAttribute, BufferGeometry, Color, DirectionalLight, DoubleSide, Group, HemisphereLight, LineBasicMaterial, LineLoop,
  LineSegments, Mesh, MeshBasicMaterial, MeshLambertMaterial, PerspectiveCamera, Scene, ShapeUtils, Vector2, Vector3, WebGLRenderer,
} from "three";
import type { Contour, LiveSection } from "../models.ts";
import { evenly, thinned } from "./contours.ts";

export interface TubeColours {
  ground: string;
  tissue: string;
  mucosa: string;
  ink: string;
}

/** Number of points of the outer wall around the tube. */
const AROUND = 96;
/** Maximum number of points per contour of the stack. */
const POINTS = 320;
/** Drawn length of the tube in largest radii. At true scale the tube would be a thread. */
const SLENDERNESS = 7;
/** Direction of the view: radians from the axis, and above it. */
const VIEW = { azimuth: 0.74, elevation: 0.3 };
/** Distance between lines across the axis, micrometres. */
const TICK = 10_000;
const FRAME = 1000 / 30;
/** Material of cut faces: visible from both sides, and behind the contours in the same plane. */
const CUT = { side: DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };

export class Tube {
  readonly #renderer: WebGLRenderer;
  readonly #scene = new Scene();
  readonly #camera = new PerspectiveCamera(26, 1, 1, 1e6);
  readonly #tube = new Group();
  readonly #slices = new Map<LiveSection, Slice>();
  readonly #tissue = new MeshLambertMaterial(CUT);
  readonly #front = new MeshLambertMaterial(CUT);
  readonly #mucosa = new LineBasicMaterial();
  readonly #outside = new MeshLambertMaterial({ transparent: true, opacity: 0.4, depthWrite: false });
  readonly #axisLine = new LineBasicMaterial({ transparent: true, opacity: 0.45 });
  readonly #ground = new MeshBasicMaterial(CUT);
  readonly #wall = new Mesh(new BufferGeometry(), this.#outside);
  /** Face that closes the lumen of the newest section, so that its folds stand out. */
  readonly #lumen = new Mesh(new BufferGeometry(), this.#ground);
  readonly #axis: LineSegments;
  /** Micrometres. */
  readonly #length: number;
  #radius = 0;
  #azimuth = VIEW.azimuth;
  #elevation = VIEW.elevation;
  #swaying = false;
  #turned = false;
  #frame = 0;
  #drawn = 0;

  /**
   * @param length Length of the whole tube, micrometres.
   * @param ends Elements that are moved to the isthmus and the ampulla.
   * @throws Error without WebGL2.
   */
  constructor(canvas: HTMLCanvasElement, length: number, private readonly ends: readonly [HTMLElement, HTMLElement]) {
    const context = canvas.getContext("webgl2", { antialias: true, alpha: true, powerPreference: "low-power" });
    if (!context) throw new Error("WebGL2 is missing");
    this.#renderer = new WebGLRenderer({ canvas, context });
    this.#length = length;
    this.#axis = new LineSegments(axis(length), this.#axisLine);
    const light = new DirectionalLight(0xffffff, 1.9);
    light.position.set(0.6, 1, 1.4);
    this.#tube.add(this.#wall, this.#lumen, this.#axis);
    this.#scene.add(this.#tube, light, new HemisphereLight(0xffffff, 0xc9a7b4, 2));
  }

  /** Factor by which the drawn tube is shorter than the real one. */
  get compression(): number {
    return 1 / this.#tube.scale.z;
  }

  paint({ ground, tissue, mucosa, ink }: TubeColours): void {
    this.#ground.color.set(ground);
    this.#front.color.set(tissue);
    this.#tissue.color.set(tissue).lerp(new Color(ground), 0.25);
    this.#outside.color.set(tissue);
    this.#mucosa.color.set(mucosa);
    this.#axisLine.color.set(ink);
    this.render();
  }

  /** Draws these sections, isthmus end first. */
  show(sections: readonly LiveSection[]): void {
    const present = new Set(sections);
    for (const [section, slice] of this.#slices) {
      if (present.has(section)) continue;
      this.#tube.remove(slice.cut, slice.edge);
      disposeSlice(slice);
      this.#slices.delete(section);
    }
    const last = sections.at(-1);
    for (const section of sections) {
      if (!section.inner) continue;
      let slice = this.#slices.get(section);
      if (!slice) {
        slice = this.#slice(section.inner, section);
        this.#slices.set(section, slice);
        this.#tube.add(slice.cut, slice.edge);
      }
      slice.cut.material = section === last ? this.#front : this.#tissue;
    }
    this.#radius = Math.max(0, ...sections.map(({ outer }) => reach(outer)));
    this.#wall.geometry.dispose();
    this.#wall.geometry = wall(sections);
    this.#lumen.geometry.dispose();
    this.#lumen.geometry = last?.inner ? filled(thinned(last.inner, POINTS), last.z_um) : new BufferGeometry();
    if (this.#radius > 0) this.#tube.scale.z = Math.min(1, (SLENDERNESS * this.#radius) / this.#length);
    this.render();
  }

  #slice(inner: Contour, { outer, z_um: z }: LiveSection): Slice {
    const [hole, rim] = [thinned(inner, POINTS), thinned(outer, AROUND)];
    const triangles = ShapeUtils.triangulateShape(vectors(rim), [vectors(hole)]).flat();
    const cut = new BufferGeometry();
    cut.setAttribute("position", new BufferAttribute(flat([rim, hole], z), 3));
    cut.setIndex(triangles);
    cut.computeVertexNormals();
    const edge = new BufferGeometry();
    edge.setAttribute("position", new BufferAttribute(flat([hole], z), 3));
    return { cut: new Mesh(cut, this.#tissue), edge: new LineLoop(edge, this.#mucosa) };
  }

  resize(width: number, height: number): void {
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.#renderer.setSize(width, height, false);
    this.#camera.aspect = width / height;
    this.render();
  }

  /** Starts or stops a gentle sway, which ends when the user turns the tube. */
  sway(on: boolean): void {
    this.#swaying = on;
    this.render();
  }

  /** Turns the tube, radians. */
  turn(across: number, up: number): void {
    this.#turned = true;
    this.#azimuth += across;
    this.#elevation = Math.max(-1.4, Math.min(1.4, this.#elevation + up));
    this.render();
  }

  /** Draws with the next frame. */
  render(): void {
    this.#frame ||= requestAnimationFrame((now) => {
      this.#frame = 0;
      const moving = this.#swaying && !this.#turned;
      if (!moving || now - this.#drawn >= FRAME) this.#draw(now, moving);
      if (moving) this.render();
    });
  }

  #draw(now: number, moving: boolean): void {
    this.#drawn = now;
    this.#aim(this.#azimuth + (moving ? 0.14 * Math.sin(now / 2600) : 0));
    this.#renderer.render(this.#scene, this.#camera);
    this.ends.forEach((end, k) => this.#place(end, k * this.#length));
  }

  /** Looks at the whole length from a direction, as close as it fits. */
  #aim(azimuth: number): void {
    const [camera, radius, length] = [this.#camera, Math.max(this.#radius, 1), this.#length * this.#tube.scale.z];
    const level = Math.cos(this.#elevation);
    const back = new Vector3(Math.sin(azimuth) * level, Math.sin(this.#elevation), Math.cos(azimuth) * level);
    const right = new Vector3(0, 1, 0).cross(back).normalize();
    const up = back.clone().cross(right);
    const tall = Math.tan((camera.fov * Math.PI) / 360);
    let distance = 0;
    for (const x of [-radius, radius]) {
      for (const y of [-radius, radius]) {
        for (const z of [-length / 2, length / 2]) {
          const corner = new Vector3(x, y, z);
          const away = Math.max(Math.abs(corner.dot(right)) / camera.aspect, Math.abs(corner.dot(up))) / tall;
          distance = Math.max(distance, corner.dot(back) + away);
        }
      }
    }
    const centre = new Vector3(0, 0, length / 2);
    camera.position.copy(centre).addScaledVector(back, distance * 1.06);
    camera.near = distance / 100;
    camera.far = distance * 4;
    camera.lookAt(centre);
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
  }

  /** Moves the name of an end below its drawing. */
  #place(end: HTMLElement, z: number): void {
    const { clientWidth, clientHeight } = this.#renderer.domElement;
    const near = [...this.#slices.keys()].filter(({ z_um }) => Math.abs(z_um - z) < this.#length / 4);
    const below = Math.max(this.#radius / 6, ...near.map(({ outer }) => reach(outer)));
    const at = new Vector3(0, -below, z * this.#tube.scale.z).project(this.#camera);
    const [x, y] = [((at.x + 1) / 2) * clientWidth, ((1 - at.y) / 2) * clientHeight];
    end.style.transform = `translate(-50%, 0) translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
  }

  dispose(): void {
    cancelAnimationFrame(this.#frame);
    this.#slices.forEach(disposeSlice);
    this.#wall.geometry.dispose();
    this.#lumen.geometry.dispose();
    this.#axis.geometry.dispose();
    for (const material of [this.#tissue, this.#front, this.#ground, this.#mucosa, this.#outside, this.#axisLine]) material.dispose();
    this.#renderer.dispose();
    // A lost context may return.
    if (!this.#renderer.getContext().isContextLost()) this.#renderer.forceContextLoss();
  }
}

interface Slice {
  cut: Mesh<BufferGeometry, MeshLambertMaterial>;
  edge: LineLoop;
}

function disposeSlice({ cut, edge }: Slice): void {
  cut.geometry.dispose();
  edge.geometry.dispose();
}

function filled(contour: Contour, z: number): BufferGeometry {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(flat([contour], z), 3));
  geometry.setIndex(ShapeUtils.triangulateShape(vectors(contour), []).flat());
  return geometry;
}

/** The outer wall through all sections. */
function wall(sections: readonly LiveSection[]): BufferGeometry {
  const rings = sections.map(({ outer }) => evenly(outer, AROUND));
  const positions = new Float32Array(3 * AROUND * rings.length);
  rings.forEach((ring, row) => positions.set(flat([ring], sections[row]!.z_um), 3 * AROUND * row));
  const triangles: number[] = [];
  for (let row = 0; row + 1 < rings.length; row++) {
    for (let k = 0; k < AROUND; k++) {
      const [a, b] = [row * AROUND + k, row * AROUND + ((k + 1) % AROUND)];
      triangles.push(a, b, b + AROUND, a, b + AROUND, a + AROUND);
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(positions, 3));
  geometry.setIndex(triangles);
  geometry.computeVertexNormals();
  return geometry;
}

/** The axis over the whole length, with ticks. */
function axis(length: number): BufferGeometry {
  const points = [0, 0, 0, 0, 0, length];
  const half = length / 150;
  for (let z = 0; z <= length + 1; z += TICK) points.push(-half, 0, z, half, 0, z);
  return new BufferGeometry().setAttribute("position", new BufferAttribute(Float32Array.from(points), 3));
}

function flat(contours: readonly Contour[], z: number): Float32Array {
  const positions = new Float32Array(contours.reduce((sum, contour) => sum + contour.length, 0) * 1.5);
  let to = 0;
  for (const contour of contours) {
    for (let from = 0; from < contour.length; from += 2) {
      positions[to++] = contour[from]!;
      positions[to++] = contour[from + 1]!;
      positions[to++] = z;
    }
  }
  return positions;
}

function vectors(contour: Contour): Vector2[] {
  return Array.from({ length: contour.length / 2 }, (_, k) => new Vector2(contour[2 * k], contour[2 * k + 1]));
}

function reach(contour: Contour): number {
  let most = 0;
  for (let at = 0; at < contour.length; at += 2) most = Math.max(most, Math.hypot(contour[at]!, contour[at + 1]!));
  return most;
}
