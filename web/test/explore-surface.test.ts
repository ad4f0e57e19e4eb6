// Reading of surfaces from quantized files.
import assert from "node:assert/strict";
import { test } from "node:test";
import { readSurface } from "../src/explore/viewer/surface.ts";
import { glb } from "./glb.ts";

/** A file with one triangle, on a grid whose steps differ by axis. */
function file(name: string, positions: Int16Array, normals: Int8Array, scale: number[]): ArrayBuffer {
  const json = {
    asset: { version: "2.0", extras: { level: { distance_um: 1.25, precision_um: [0.05, 0.04, 0.9] } } },
    extensionsUsed: ["KHR_mesh_quantization"],
    extensionsRequired: ["KHR_mesh_quantization"],
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ name: "tissue", children: [1], scale, translation: [0.001, 0, 0] }, { name, mesh: 0 }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0, NORMAL: 1 }, indices: 2 }] }],
    accessors: [
      { bufferView: 0, componentType: 5122, normalized: true, count: 3, type: "VEC3", min: [0, 0, 0], max: [1, 1, 1] },
      { bufferView: 1, componentType: 5120, normalized: true, count: 3, type: "VEC3" },
      { bufferView: 2, componentType: 5123, count: 3, type: "SCALAR" },
    ],
    bufferViews: [
      { buffer: 0, byteOffset: 0, byteLength: 24, byteStride: 8 },
      { buffer: 0, byteOffset: 24, byteLength: 12, byteStride: 4 },
      { buffer: 0, byteOffset: 36, byteLength: 6 },
    ],
    buffers: [{ byteLength: 44 }],
  };
  return glb(json, 44, (view, at) => {
    for (let vertex = 0; vertex < 3; vertex++) {
      for (let axis = 0; axis < 3; axis++) {
        view.setInt16(at + 8 * vertex + 2 * axis, positions[3 * vertex + axis]!, true);
        view.setInt8(at + 24 + 4 * vertex + axis, normals[3 * vertex + axis]!);
      }
      view.setUint16(at + 36 + 2 * vertex, vertex, true);
    }
  });
}

test("positions are in millimetres from the begin of the piece, and normals are perpendicular, whatever the steps of the axes", async () => {
  const scale = [0.001, 0.002, 0.06];
  // In millimetres: (1, 0, 0), (1, 2, 0) and (2, 0, 60), with the normal (60, 0, -1) scaled to
  // length 1.
  const positions = Int16Array.of(0, 0, 0, 0, 32767, 0, 32767, 0, 32767);
  const normal = [60 * scale[0]!, 0, -1 * scale[2]!];
  const length = Math.hypot(...normal);
  const normals = Int8Array.from([0, 1, 2].flatMap(() => normal.map((n) => Math.round((127 * n) / length))));
  const { patches, triangles, difference } = await readSurface(file("inner_wall", positions, normals, scale), 25);
  assert.equal(triangles, 1);
  assert.deepEqual(difference, { distance: 1.25, precision: [0.05, 0.04, 0.9] });
  const [patch] = patches;
  const expected = [1, 0, -25, 1, 2, -25, 2, 0, 35];
  patch!.positions.forEach((value, i) => assert.ok(Math.abs(value - expected[i]!) < 1e-4, `${i}: ${value}`));
  const [x, y, z] = patch!.normals;
  assert.ok(x! >= 126 && y === 0 && (z === -2 || z === -3), `${x} ${y} ${z}`);
});

test("a file without walls is refused", async () => {
  await assert.rejects(readSurface(file("teapot", new Int16Array(9), new Int8Array(9), [1, 1, 1]), 0), /no walls/);
});
