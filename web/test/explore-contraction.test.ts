// The contraction of a model, without a picture.
import assert from "node:assert/strict";
import { test } from "node:test";
import type { Model } from "oviduct-client";
import { glb } from "./glb.ts";

const query = Object.assign(new EventTarget(), { matches: false });
Object.assign(globalThis, { matchMedia: () => query, document: { documentElement: { dataset: {} }, baseURI: "http://lab.example/" } });
const { Contraction, timeInWords } = await import("../src/explore/contraction.ts");
const { View } = await import("../src/explore/view.ts");
const { readMotion } = await import("../src/explore/viewer/motion.ts");

const TUBE = { begin: 0, length: 20, radius: 1, x: 0, y: 0 };

/**
 * A file of one triangle with two frames. In the second it is 1 mm higher along y and faces the
 * other way.
 */
function file(animated = true): ArrayBuffer {
  const floats = [
    ...[0, 0, 0.025, 0.001, 0, 0.025, 0, 0.001, 0.025],
    ...[0, 0, 1, 0, 0, 1, 0, 0, 1],
    ...[0, 0.001, 0, 0, 0.001, 0, 0, 0.001, 0],
    ...[0, 0, -2, 0, 0, -2, 0, 0, -2],
    ...[0, 2, 4],
    ...[0, 1, 0],
  ];
  const vectors = { componentType: 5126, count: 3, type: "VEC3" };
  const numbers = { componentType: 5126, count: 3, type: "SCALAR" };
  const json = {
    asset: { version: "2.0" },
    scene: 0,
    scenes: [{ nodes: [0] }],
    nodes: [{ name: "inner_wall", mesh: 0 }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0, NORMAL: 1 }, indices: 6, targets: [{ POSITION: 2, NORMAL: 3 }] }] }],
    accessors: [
      { bufferView: 0, ...vectors, min: [0, 0, 0.025], max: [0.001, 0.001, 0.025] },
      { bufferView: 1, ...vectors },
      { bufferView: 2, ...vectors, min: [0, 0.001, 0], max: [0, 0.001, 0] },
      { bufferView: 3, ...vectors },
      { bufferView: 4, ...numbers, min: [0], max: [4] },
      { bufferView: 5, ...numbers },
      { bufferView: 6, componentType: 5125, count: 3, type: "SCALAR" },
    ],
    bufferViews: [0, 36, 72, 108, 144, 156, 168].map((byteOffset, k) => ({ buffer: 0, byteOffset, byteLength: k < 4 ? 36 : 12 })),
    buffers: [{ byteLength: 180 }],
    ...(animated && {
      animations: [{ name: "contraction", channels: [{ sampler: 0, target: { node: 0, path: "weights" } }], samplers: [{ input: 4, output: 5 }] }],
    }),
  };
  return glb(json, 180, (view, at) => {
    floats.forEach((value, i) => view.setFloat32(at + 4 * i, value, true));
    [0, 1, 2].forEach((value, i) => view.setUint32(at + 168 + 4 * i, value, true));
  });
}

const heights = ({ surface }: { surface: { patches: readonly { positions: Float32Array }[] } }) => {
  const { positions } = surface.patches[0]!;
  return [1, 4, 7].map((i) => Math.round(1000 * positions[i]!) / 1000);
};

test("a motion has frames in millimetres, and vertices move in straight lines between them and back to the first", async () => {
  const motion = await readMotion(file(), 5);
  assert.deepEqual([motion.frames, motion.period, motion.surface.triangles], [2, 4, 1]);
  const [patch] = motion.surface.patches;
  assert.equal(patch!.positions[2], 20);
  const seen = [0, 0.25, 0.5, 0.75, 1].map((phase) => (motion.moveTo(phase), [heights(motion)[0], patch!.normals[2]]));
  assert.deepEqual(seen, [[0, 127], [0.5, 0], [1, -127], [0.5, 0], [0, 127]]);
  assert.equal(patch!.straight, patch!.positions, "a straight tube has no positions of its own");
});

test("a file without an animation is refused", async () => {
  await assert.rejects(readMotion(file(false), 0), /no animation/);
});

test("times name the frame that is shown and the seconds", () => {
  const clip = { frames: 20, period: 4 };
  assert.deepEqual([0, 0.3, 0.31, 0.95, 1].map((phase) => timeInWords(phase, clip)), [
    "Frame 1 of 20 · 0.00 s", "Frame 7 of 20 · 1.20 s", "Frame 7 of 20 · 1.24 s", "Frame 20 of 20 · 3.80 s", "Frame 1 of 20 · 4.00 s",
  ]);
});

test("a contraction plays at its own pace, stops where it is sought, and leaves the tube at rest", async () => {
  const view = new View(TUBE);
  const model = { id: "m", files: [{ name: "animation.glb", bytes: 180 }] } as unknown as Model;
  const contraction = new Contraction(model, view, TUBE);
  const motion = await readMotion(file(), 0);
  contraction.motion.value = motion;
  assert.equal(contraction.shown.value, undefined);
  let moved = 0;
  contraction.onMove = () => moved++;
  contraction.start();
  assert.deepEqual([contraction.playing.value, contraction.shown.value], [true, motion]);
  for (let now = 1000; now <= 2000; now += 20) assert(contraction.advance(now));
  // One second of four: half of the way to the second frame.
  assert.deepEqual(heights(motion), [0.5, 0.5, 1.5]);
  assert(moved >= 50 && Math.abs(view.phase.value! - 0.25) < 0.03, `${moved} ${view.phase.value}`);
  contraction.toggle();
  assert.deepEqual([contraction.advance(2020), Math.abs(view.phase.value! - 0.25) < 1e-9], [false, true]);
  contraction.toggle();
  for (let now = 9000; now <= 12_200; now += 50) contraction.advance(now);
  assert(Math.abs(contraction.phase.value - 0.05) < 0.03, "it begins again");
  contraction.seek(0.5);
  assert.deepEqual([heights(motion), contraction.playing.value, view.phase.value], [[1, 1, 2], false, 0.5]);
  contraction.leave();
  assert.deepEqual([contraction.shown.value, view.phase.value, contraction.advance(20_000)], [undefined, undefined, false]);
  contraction.dispose();
});

test("a model without an animation has nothing to play, whatever the link says", () => {
  const view = new View(TUBE);
  view.phase.value = 0.5;
  const contraction = new Contraction({ id: "m", files: [] } as unknown as Model, view, TUBE);
  assert.deepEqual([contraction.file, contraction.loading.value, contraction.shown.value], [undefined, undefined, undefined]);
  contraction.dispose();
});
