// A moving surface: frames of an animation with the same triangles, and interpolation between them.
import type { Mesh } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import type { Course } from "../course.ts";
import { indexOf, isMesh, PATCH_NAMES, vectorsOf, type Patch, type PatchName, type Surface } from "./surface.ts";

/** The part of a patch that differs between frames. */
type Shape = Pick<Patch, "positions" | "straight" | "normals">;

export class Motion {
  /** The surface at the current time; its arrays are overwritten when it moves. */
  readonly surface: Surface;
  /** Number of frames per period. */
  readonly frames: number;
  /** Period in seconds. */
  readonly period: number;
  /** Frames of each patch of the surface. */
  readonly #shapes: readonly (readonly Shape[])[];

  constructor(surface: Surface, shapes: readonly (readonly Shape[])[], period: number) {
    this.surface = surface;
    this.frames = shapes[0]!.length;
    this.period = period;
    this.#shapes = shapes;
  }

  /** Moves to a fraction of the period. Between two frames, vertices move in straight lines. */
  moveTo(phase: number): void {
    const at = (phase - Math.floor(phase)) * this.frames;
    const from = Math.floor(at) % this.frames;
    for (const [k, patch] of this.surface.patches.entries()) {
      const shapes = this.#shapes[k]!;
      mix(shapes[from]!, shapes[(from + 1) % this.frames]!, at - Math.floor(at), patch);
    }
  }
}

function mix(a: Shape, b: Shape, part: number, out: Shape): void {
  for (const name of ["positions", "normals", "straight"] as const) {
    const [from, to, into] = [a[name], b[name], out[name]];
    if (name === "straight" && into === out.positions) continue;
    for (let i = 0; i < into.length; i++) into[i] = from[i]! + part * (to[i]! - from[i]!);
  }
}

/**
 * Reads a `.glb` whose morph targets are the frames after the first. Throws if the file is damaged.
 *
 * The tube may follow a course.
 */
export async function readMotion(file: ArrayBuffer, begin: number, course?: Course): Promise<Motion> {
  const { scene, animations } = await new GLTFLoader().parseAsync(file, "");
  const [clip] = animations;
  if (!clip) throw new Error("The file has no animation.");
  scene.updateMatrixWorld(true);
  const [patches, shapes]: [Patch[], Shape[][]] = [[], []];
  scene.traverse((node) => {
    const name = PATCH_NAMES.find((name) => name === node.name);
    if (!name || !isMesh(node)) return;
    const { patch, frames } = read(name, node, begin, course);
    patches.push(patch);
    shapes.push(frames);
  });
  if (patches.length === 0) throw new Error("The file has no walls of a tube.");
  if (shapes.some(({ length }) => length < 2 || length !== shapes[0]!.length)) throw new Error("The file has no frames.");
  const triangles = patches.reduce((sum, { index }) => sum + index.length / 3, 0);
  return new Motion({ patches, triangles, difference: undefined }, shapes, clip.duration);
}

/** A patch with separate arrays, and its frames. */
function read(name: PatchName, { geometry, matrixWorld }: Mesh, begin: number, course: Course | undefined): { patch: Patch; frames: Shape[] } {
  const index = indexOf(geometry);
  const targets = geometry.morphAttributes.position?.length ?? 0;
  const frames = Array.from({ length: targets + 1 }, (_, frame): Shape => {
    const { positions, normals } = vectorsOf(geometry, matrixWorld, begin, frame - 1);
    return { positions, normals, straight: course?.straighten(positions, index) ?? positions };
  });
  const [first] = frames as [Shape];
  const positions = first.positions.slice();
  const patch = {
    name,
    positions,
    straight: first.straight === first.positions ? positions : first.straight.slice(),
    normals: first.normals.slice(),
    index,
  };
  return { patch, frames };
}
