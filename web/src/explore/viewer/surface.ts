// The surface of a model as arrays in millimetres, read from its glTF files of any level of detail.
import type { BufferAttribute, InterleavedBufferAttribute, Mesh, Object3D } from "three";
import { Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { MeshoptDecoder } from "three/addons/libs/meshopt_decoder.module.js";

export const PATCH_NAMES = ["inner_wall", "outer_wall", "cap_isthmus", "cap_ampulla"] as const;
export type PatchName = (typeof PATCH_NAMES)[number];

export interface Patch {
  name: PatchName;
  /** x, y, z of each vertex, millimetres. */
  positions: Float32Array;
  normals: BufferAttribute | InterleavedBufferAttribute;
  /** Three vertices a triangle. */
  index: Uint16Array | Uint32Array;
}

export interface Surface {
  patches: readonly Patch[];
  triangles: number;
}

/** Reads a `.glb`. Throws if it is damaged or has no patch of a tissue. */
export async function readSurface(file: ArrayBuffer): Promise<Surface> {
  const loader = new GLTFLoader().setMeshoptDecoder(MeshoptDecoder);
  const { scene } = await loader.parseAsync(file, "");
  scene.updateMatrixWorld(true);
  const patches: Patch[] = [];
  scene.traverse((node) => {
    const name = PATCH_NAMES.find((name) => name === node.name);
    if (name && isMesh(node)) patches.push(patch(name, node));
  });
  if (patches.length === 0) throw new Error("The file has no walls of a tube.");
  return { patches, triangles: patches.reduce((sum, { index }) => sum + index.length / 3, 0) };
}

function isMesh(node: Object3D): node is Mesh {
  return "isMesh" in node;
}

/** Quantized positions are scaled by the transform of the node; glTF is in metres. */
function patch(name: PatchName, { geometry, matrixWorld }: Mesh): Patch {
  const [position, point] = [geometry.getAttribute("position"), new Vector3()];
  const positions = new Float32Array(3 * position.count);
  for (let i = 0; i < position.count; i++) {
    point.fromBufferAttribute(position, i).applyMatrix4(matrixWorld).multiplyScalar(1000).toArray(positions, 3 * i);
  }
  if (!geometry.hasAttribute("normal")) geometry.computeVertexNormals();
  const normals = geometry.getAttribute("normal");
  const order = geometry.index?.array ?? Uint32Array.from({ length: position.count }, (_, i) => i);
  const index = order instanceof Uint16Array || order instanceof Uint32Array ? order : Uint32Array.from(order);
  return { name, positions, normals, index };
}
