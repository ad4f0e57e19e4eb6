// A surface that moves: the frames of an animation, which have the same triangles, and what is between them.
import { Matrix3, Vector3, type BufferGeometry, type Mesh } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import type { Course } from "../course.ts";
import { isMesh, PATCH_NAMES, type Patch, type PatchName, type Surface } from "./surface.ts";

/** What differs between the frames of a patch. */
type Shape = Pick<Patch, "positions" | "straight" | "normals">;

export class Motion {
  /** Its patches are those at the present time: they are written again when it moves. */
  readonly surface: Surface;
  /** Number of frames of one period. */
  readonly frames: number;
  /** Seconds. */
  readonly period: number;
  /** Frames of each patch of the surface. */
  readonly #shapes: readonly (readonly Shape[])[];

  constructor(surface: Surface, shapes: readonly (readonly Shape[])[], period: number) {
    this.surface = surface;
    this.frames = shapes[0]!.length;
    this.period = period;
    this.#shapes = shapes;
  }

  /** Moves to a part of the period: to a frame, or between two, where vertices move in straight lines. */
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

/** Reads a `.glb` whose morph targets are frames after the first, of a tube that may follow a course. Throws if it is damaged. */
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

/** A patch of its own arrays, and its frames. */
function read(name: PatchName, { geometry, matrixWorld }: Mesh, begin: number, course: Course | undefined): { patch: Patch; frames: Shape[] } {
  const order = geometry.index?.array;
  if (!(order instanceof Uint16Array || order instanceof Uint32Array)) throw new Error("The file has no list of triangles.");
  const targets = geometry.morphAttributes.position?.length ?? 0;
  const frames = Array.from({ length: targets + 1 }, (_, frame): Shape => {
    const { positions, normals } = vectors(geometry, frame - 1, matrixWorld, begin);
    return { positions, normals, straight: course?.straighten(positions, order) ?? positions };
  });
  const [first] = frames as [Shape];
  const positions = first.positions.slice();
  const patch = {
    name,
    positions,
    straight: first.straight === first.positions ? positions : first.straight.slice(),
    normals: first.normals.slice(),
    index: order,
  };
  return { patch, frames };
}

/** Positions in millimetres and normals of a frame; −1 is the geometry itself, others are displaced from it. */
function vectors(geometry: BufferGeometry, target: number, matrix: Mesh["matrixWorld"], begin: number): Pick<Shape, "positions" | "normals"> {
  const [position, normal] = [geometry.getAttribute("position"), geometry.getAttribute("normal")];
  const [moved, turned] = [geometry.morphAttributes.position?.[target], geometry.morphAttributes.normal?.[target]];
  const [vector, displacement, direction] = [new Vector3(), new Vector3(), new Matrix3().getNormalMatrix(matrix)];
  const positions = new Float32Array(3 * position.count);
  const normals = new Int8Array(3 * position.count);
  for (let i = 0; i < position.count; i++) {
    vector.fromBufferAttribute(position, i);
    if (moved) vector.add(displacement.fromBufferAttribute(moved, i));
    vector.applyMatrix4(matrix).multiplyScalar(1000);
    vector.z -= begin;
    vector.toArray(positions, 3 * i);
    vector.fromBufferAttribute(normal, i);
    if (turned) vector.add(displacement.fromBufferAttribute(turned, i));
    vector.applyNormalMatrix(direction).multiplyScalar(127).toArray(normals, 3 * i);
  }
  return { positions, normals };
}
