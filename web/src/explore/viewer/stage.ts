// The picture of one model: scene, camera and renderer. It draws only after changes.
import { computed, effect, signal, untracked } from "@preact/signals";
import { PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import { FIELD, type Tube } from "../framing.ts";
import type { Spot } from "../measure.ts";
import type { StandardView } from "../pose.ts";
import type { View, Viewpoint } from "../view.ts";
import type { Way } from "../way.ts";
import { dark } from "../../ui/theme.ts";
import { glideFrom } from "../motion.ts";
import { control } from "./controls.ts";
import { Cuts } from "./cuts.ts";
import { OUTSIDE_DARK } from "./dark.ts";
import type { Device } from "./device.ts";
import { FLIGHT_FIELD, FlightCamera, nearPlane } from "./flight-camera.ts";
import { firstHit, firstHitBent } from "./ray.ts";
import { Resolution } from "./resolution.ts";
import { SectionPlane } from "./section-plane.ts";
import { around, seenThroughEnds, type Stretch } from "./sight.ts";
import type { Patch, Surface } from "./surface.ts";
import { Tissue } from "./tissue.ts";
import { FLIGHT_FOG } from "./tissue-material.ts";

/** Turn of the picture per key press and per pixel of a drag, degrees. */
const KEY_TURN = 6;
const DRAG_TURN = 0.35;
const KEY_PAN = 40;
const KEY_ZOOM = 1.15;
/**
 * Distance in millimetres at which edges are two thirds of a pixel wide, per pixel of the picture's
 * height.
 */
const FINEST_EDGE = 0.03;
const VIEW_KEYS: Record<string, StandardView> = { Home: "whole", "1": "whole", "2": "isthmus", "3": "ampulla", "4": "side" };

export class Stage {
  /** True while the browser has revoked the graphics context; it usually returns. */
  readonly lost = signal(false);
  /** Called with tapped points of the surface. */
  onPick: ((spot: Spot) => void) | undefined;
  /** Called after each frame, to move the overlays. */
  onFrame: (() => void) | undefined;
  /** Called for keys of the flight; returns true if the key has a function. */
  onKey: ((key: string) => boolean) | undefined;
  /** Called before each frame to advance animations; returns true while they continue. */
  onAdvance: ((now: number) => boolean) | undefined;
  readonly #view: View;
  readonly #tube: Tube;
  readonly #viewpoint: Viewpoint;
  readonly #canvas: HTMLCanvasElement;
  readonly #renderer: WebGLRenderer;
  readonly #resolution: Resolution;
  readonly #scene = new Scene();
  readonly #camera = new PerspectiveCamera(FIELD, 1, 0.1, 1000);
  readonly #flight: FlightCamera;
  readonly #tissue: Tissue;
  readonly #cuts: Cuts;
  readonly #plane: SectionPlane;
  readonly #surface = signal<Surface | undefined>(undefined);
  readonly #way = signal<Way | undefined>(undefined);
  /** True while the camera is in the lumen: the flight begins when there is a way. */
  readonly #flying = computed(() => this.#view.flying.value && this.#way.value !== undefined);
  readonly #abort = new AbortController();
  readonly #leave: (() => void)[] = [];
  readonly #target = new Vector3();
  readonly #inside: Stretch = { from: 0, to: 0 };
  #pending = 0;
  #frames = 0;
  #coarse = false;
  #resized = true;

  /** @throws Error if the browser provides no WebGL2 context. */
  constructor(canvas: HTMLCanvasElement, view: View, tube: Tube, { strength }: Device) {
    this.#canvas = canvas;
    this.#view = view;
    this.#tube = tube;
    this.#viewpoint = view.viewpointOf(tube);
    const software = strength === "software";
    this.#renderer = new WebGLRenderer({ canvas, antialias: !software, alpha: true, stencil: true, powerPreference: "high-performance" });
    this.#resolution = new Resolution(software, this.#request);
    this.#renderer.localClippingEnabled = true;
    this.#flight = new FlightCamera(tube);
    this.#tissue = new Tissue(tube.course !== undefined);
    this.#cuts = new Cuts(tube);
    this.#plane = new SectionPlane(tube);
    this.#scene.add(this.#tissue.group, this.#cuts.group, this.#plane.group, this.#camera);
    this.#fix();
    this.#listen();
    this.#follow();
  }

  show(surface: Surface): void {
    this.#cuts.show(surface, this.#tissue.show(surface, this.#tube.length));
    this.#fix();
    this.#surface.value = surface;
  }

  /** Updates the picture after the shown surface has moved. */
  moved(): void {
    const surface = this.#surface.peek();
    if (!surface) return;
    this.#tissue.moved();
    // Assign a new object, so that cuts are traced again.
    this.#surface.value = { ...surface };
  }

  /** Sets the way through the lumen; without one, a flight shows the model from outside. */
  set way(way: Way | undefined) {
    this.#way.value = way;
  }

  /**
   * Writes the projected position of a point to `out`, in pixels of the page.
   *
   * Returns true if the point is in front of the camera.
   */
  project({ x, y, z }: Spot, out: Vector3): boolean {
    out.set(x, y, z).project(this.#camera);
    out.x = ((out.x + 1) / 2) * this.#canvas.clientWidth;
    out.y = ((1 - out.y) / 2) * this.#canvas.clientHeight;
    return out.z < 1;
  }

  invalidate = (): void => {
    this.#resolution.moved();
    this.#request();
  };

  readonly #request = (): void => {
    if (this.#pending === 0 && !this.#abort.signal.aborted) this.#pending = requestAnimationFrame(this.#draw);
  };

  dispose(): void {
    this.#abort.abort();
    cancelAnimationFrame(this.#pending);
    for (const leave of this.#leave) leave();
    this.#tissue.dispose();
    this.#cuts.dispose();
    this.#plane.dispose();
    this.#resolution.dispose();
    this.#renderer.dispose();
    // Browsers allow few contexts at a time, and collect contexts of removed canvases late.
    this.#renderer.forceContextLoss();
  }

  /** Computes the matrices of all objects except the camera once; only the camera moves. */
  #fix(): void {
    this.#scene.traverse((object) => {
      if (object === this.#camera || !object.matrixAutoUpdate) return;
      object.updateMatrix();
      object.matrixAutoUpdate = false;
    });
  }

  #listen(): void {
    const { signal } = this.#abort;
    const observer = new ResizeObserver(() => this.#resize());
    observer.observe(this.#canvas);
    this.#leave.push(() => observer.disconnect());
    this.#resize();
    this.#canvas.addEventListener("webglcontextlost", () => (this.lost.value = true), { signal });
    this.#canvas.addEventListener("webglcontextrestored", () => ((this.lost.value = false), this.invalidate()), { signal });
    control(
      this.#canvas,
      {
        turn: (right, down) => this.#turn(right * DRAG_TURN, down * DRAG_TURN),
        pan: (right, down) => this.#pan(right, down),
        zoom: (factor) => this.#zoom(factor),
        tap: (x, y) => this.#pick(x, y),
        key: (key, shift) => this.#key(key, shift),
      },
      signal,
    );
  }

  /** Draws again after changes of the shown state. */
  #follow(): void {
    const view = this.#view;
    this.#leave.push(
      effect(() => {
        this.#apply();
        this.invalidate();
      }),
      effect(() => {
        this.#plane.place(view.plane.value && !view.flying.value ? view.section.value * this.#tube.length : undefined);
        this.invalidate();
      }),
      effect(() => {
        void view.kept;
        untracked(() => view.reframe());
      }),
      effect(() => {
        const flying = this.#flying.value;
        this.#tissue.flight = flying;
        this.#renderer.setClearColor(OUTSIDE_DARK, flying ? 1 : 0);
        if (!flying) this.#flight.straighten();
        this.invalidate();
      }),
      effect(() => {
        void this.#viewpoint.pose.changes.value;
        void view.flight.value;
        this.invalidate();
      }),
      effect(() => {
        void dark.value;
        this.#plane.color = getComputedStyle(this.#canvas).color;
        this.invalidate();
      }),
    );
  }

  #apply(): void {
    this.#cuts.apply(this.#view, this.#surface.value, this.#coarse);
    this.#tissue.apply(this.#view, this.#cuts.active, this.#cuts.backs);
  }

  #resize(): void {
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    if (width === 0 || height === 0) return;
    this.#renderer.setSize(width, height, false);
    this.#camera.aspect = width / height;
    this.#resized = true;
    this.#viewpoint.aspect = this.#camera.aspect;
    this.#view.reframe();
    this.invalidate();
  }

  // No effect runs this function, so it reads signals by `value`; `peek` allocates a function.
  readonly #draw = (now: number): void => {
    this.#pending = 0;
    if (this.lost.value) return;
    this.#viewpoint.pose.advance(now);
    if (this.onAdvance?.(now)) this.invalidate();
    this.#resolution.frame(now);
    if (this.#resolution.ratio !== this.#renderer.getPixelRatio()) this.#renderer.setPixelRatio(this.#resolution.ratio);
    if (this.#resolution.coarse !== this.#coarse) {
      this.#coarse = this.#resolution.coarse;
      this.#apply();
    }
    const flying = this.#flying.value;
    if (flying) this.#fly(this.#way.value!);
    else this.#orbit();
    this.#limit(flying);
    this.#renderer.render(this.#scene, this.#camera);
    this.#canvas.dataset["frames"] = String(++this.#frames);
    this.onFrame?.();
  };

  /** Omits triangles that a coarse picture does not show. */
  #limit(flying: boolean): void {
    const view = this.#view;
    const inside = this.#inside;
    const { position } = this.#camera;
    this.#cuts.edged = !this.#coarse || FINEST_EDGE * this.#renderer.domElement.height > this.#viewpoint.pose.distance;
    if (!this.#coarse) return this.#tissue.unlimit();
    if (flying) {
      around(view.flown * this.#tube.length, FLIGHT_FOG[1], this.#tube, inside);
    } else if (!this.#tube.course && view.closed && !this.#cuts.opensTo(position)) {
      seenThroughEnds(position, this.#tube, this.#cuts.kept, inside);
    } else {
      inside.from = -Infinity;
      inside.to = Infinity;
    }
    this.#tissue.limit(this.#cuts.planes, inside, flying);
  }

  #orbit(): void {
    const { pose } = this.#viewpoint;
    const { length, radius } = this.#tube;
    const a = (pose.azimuth * Math.PI) / 180;
    const e = (pose.elevation * Math.PI) / 180;
    const target = this.#target.set(pose.x, pose.y, pose.z * length);
    const { position } = this.#camera;
    position.set(Math.cos(e) * Math.sin(a), Math.sin(e), Math.cos(e) * Math.cos(a));
    position.multiplyScalar(pose.distance).add(target);
    this.#camera.lookAt(target);
    this.#project(FIELD, Math.max(pose.distance / 100, 0.01), pose.distance + 2 * length + 4 * radius);
  }

  #fly(way: Way): void {
    const { length, radius } = this.#tube;
    const place = this.#view.flown * length;
    this.#flight.place(this.#camera, way, place);
    const difference = (this.#surface.value?.difference?.distance ?? 0) / 1000;
    const near = nearPlane(way.clearance(place), difference, this.#camera.aspect);
    // The far plane is beyond the ends, so only they have nothing behind them.
    this.#project(FLIGHT_FIELD, near, length + 4 * radius);
  }

  #project(fov: number, near: number, far: number): void {
    const camera = this.#camera;
    if (camera.fov === fov && camera.near === near && camera.far === far && !this.#resized) return;
    this.#resized = false;
    camera.fov = fov;
    camera.near = near;
    camera.far = far;
    camera.updateProjectionMatrix();
  }

  /** Turns the picture by degrees, positive for movements of the hand to the right and down. */
  #turn(right: number, down: number): void {
    if (!this.#flying.peek()) return this.#view.orbit(-right, down);
    this.#flight.turn(right, down);
    this.invalidate();
  }

  #pan(right: number, down: number): void {
    if (this.#flying.peek()) return this.#turn(right * DRAG_TURN, down * DRAG_TURN);
    const { pose } = this.#viewpoint;
    const millimetres = (2 * pose.distance * Math.tan(((FIELD / 2) * Math.PI) / 180)) / this.#canvas.clientHeight;
    this.#view.pan(-right * millimetres, down * millimetres, this.#tube);
  }

  #zoom(factor: number): void {
    if (!this.#flying.peek()) return this.#view.zoom(factor);
    // During the flight, zooming in moves forward.
    this.#view.flight.value = Math.max(0, Math.min(1, this.#view.flown - Math.log(factor) * 0.02));
  }

  #key(key: string, shift: boolean): boolean {
    if (this.#view.flying.peek()) return this.onKey?.(key) ?? false;
    const standard = VIEW_KEYS[key];
    if (standard) return this.#view.show(standard, glideFrom()), true;
    const direction = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[key];
    if (direction) {
      const [right, down] = direction as [number, number];
      if (shift) this.#pan(-right * KEY_PAN, -down * KEY_PAN);
      else this.#turn(right * KEY_TURN, down * KEY_TURN);
      return true;
    }
    if (key === "+" || key === "=") return this.#zoom(1 / KEY_ZOOM), true;
    if (key === "-" || key === "_") return this.#zoom(KEY_ZOOM), true;
    return false;
  }

  #pick(x: number, y: number): void {
    const surface = this.#surface.peek();
    if (!surface || !this.onPick) return;
    const { clientWidth: width, clientHeight: height } = this.#canvas;
    const from = this.#camera.position;
    const direction = new Vector3((2 * x) / width - 1, 1 - (2 * y) / height, 0.5).unproject(this.#camera).sub(from).normalize();
    const ray = { ox: from.x, oy: from.y, oz: from.z, dx: direction.x, dy: direction.y, dz: direction.z };
    const isVisible = (patch: Patch) => this.#tissue.isVisible(patch);
    const distance = this.#tube.course
      ? firstHitBent([...surface.patches.filter(isVisible), ...this.#cuts.faces], this.#cuts.planes, ray)
      : firstHit(surface.patches, isVisible, this.#cuts.planes, ray);
    if (distance === undefined) return;
    const { x: px, y: py, z: pz } = direction.multiplyScalar(distance).add(from);
    this.onPick({ x: px, y: py, z: pz });
  }
}
