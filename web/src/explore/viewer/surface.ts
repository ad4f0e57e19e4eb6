// The surface of a model as arrays in millimetres, read from glTF files of any level of detail.
import { Matrix3, Vector3, type BufferGeometry, type Matrix4, type Mesh, type Object3D } from "three";
import type { Report } from "oviduct-client";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { MeshoptDecoder } from "three/addons/libs/meshopt_decoder.module.js";
import type { Course } from "../course.ts";

type DetailLevel = NonNullable<Report["levels"]>[number];

export const PATCH_NAMES = ["inner_wall", "outer_wall", "cap_isthmus", "cap_ampulla"] as const;
export type PatchName = (typeof PATCH_NAMES)[number];

export interface Patch {
  name: PatchName;
  /** x, y, z of each vertex, millimetres. */
  positions: Float32Array;
  /** Positions in the straight tube; the same array if the tube is not bent. */
  straight: Float32Array;
  /** x, y, z of each vertex normal, scaled by 127. */
  normals: Int8Array;
  /** Three vertices per triangle. */
  index: Uint16Array | Uint32Array;
}

export interface Surface {
  patches: readonly Patch[];
  triangles: number;
  /** Difference from the certified surface, if the file states it. */
  difference: Difference | undefined;
}

/** Micrometres. */
export interface Difference {
  /** Maximum measured distance between the two surfaces. */
  distance: number;
  /** Rounding steps of positions along x, y and z. */
  precision: readonly number[];
}

/**
 * Reads a `.glb` of a tube that may follow a course; `begin` millimetres along z become 0.
 *
 * @throws Error if the file is damaged or has no tissue patch.
 */
export async function readSurface(file: ArrayBuffer, begin: number, course?: Course): Promise<Surface> {
  const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
  const { scene, asset } = await loader.parseAsync(file, "");
  scene.updateMatrixWorld(true);
  const patches: Patch[] = [];
  scene.traverse((node) => {
    const name = PATCH_NAMES.find((name) => name === node.name);
    if (name && isMesh(node)) patches.push(patch(name, node, begin, course));
  });
  if (patches.length === 0) throw new Error("The file has no walls of a tube.");
  return { patches, triangles: patches.reduce((sum, { index }) => sum + index.length / 3, 0), difference: statedDifference(asset.extras) };
}

/**
 * Levels of detail state the difference in the extras of the asset, with the names of the report.
 */
function statedDifference(extras: unknown): Difference | undefined {
  const { distance_um: distance, precision_um: precision } = (extras as { level?: Partial<DetailLevel> } | undefined)?.level ?? {};
  return typeof distance === "number" ? { distance, precision: precision ?? [] } : undefined;
}

export function isMesh(node: Object3D): node is Mesh {
  return "isMesh" in node;
}

function patch(name: PatchName, { geometry, matrixWorld }: Mesh, begin: number, course: Course | undefined): Patch {
  const { positions, normals } = vectorsOf(geometry, matrixWorld, begin);
  const index = indexOf(geometry);
  return { name, positions, straight: course?.straighten(positions, index) ?? positions, normals, index };
}

/** Three vertices per triangle. */
export function indexOf({ index, attributes }: BufferGeometry): Patch["index"] {
  const order = index?.array ?? Uint32Array.from({ length: attributes["position"]!.count }, (_, i) => i);
  return order instanceof Uint16Array || order instanceof Uint32Array ? order : Uint32Array.from(order);
}

/**
 * Positions and normals of a geometry, displaced by a morph target if `target` is given.
 *
 * Quantized values are scaled by the transform of the node. glTF is in metres.
 */
export function vectorsOf(geometry: BufferGeometry, matrix: Matrix4, begin: number, target = -1): Pick<Patch, "positions" | "normals"> {
  if (!geometry.hasAttribute("normal")) geometry.computeVertexNormals();
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
