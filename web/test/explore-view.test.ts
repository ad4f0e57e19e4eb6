// Exploring in 3D: standard views, links, cut faces, picking, levels of detail.
import assert from "node:assert/strict";
import { test } from "node:test";
import { depthOf, FIELD, pixelsPerMillimetre, standardView, type Tube } from "../src/explore/framing.ts";
import { distanceUm, Measurement, readSpot, writeSpot } from "../src/explore/measure.ts";
import { STANDARD_VIEWS, type Placement } from "../src/explore/pose.ts";
import { readView, View, writeView } from "../src/explore/view.ts";
import { automaticLevel, levelsOf } from "../src/explore/viewer/levels.ts";
import { addOutline, Segments } from "../src/explore/viewer/outline.ts";
import { mucosaLight } from "../src/explore/viewer/occlusion.ts";
import { firstHit } from "../src/explore/viewer/ray.ts";
import type { Patch } from "../src/explore/viewer/surface.ts";

const tube: Tube = { begin: 0, length: 60, radius: 1.5, x: 0.02, y: -0.01 };

/** Position of a point in the picture; -1 to 1 is inside. */
function seen({ x, y, z, azimuth, elevation, distance }: Placement, aspect: number, point: [number, number, number]): [number, number] {
  const [a, e] = [(azimuth * Math.PI) / 180, (elevation * Math.PI) / 180];
  const back = [Math.cos(e) * Math.sin(a), Math.sin(e), Math.cos(e) * Math.cos(a)];
  const right = [Math.cos(a), 0, -Math.sin(a)];
  const up = [-Math.sin(e) * Math.sin(a), Math.cos(e), -Math.sin(e) * Math.cos(a)];
  const from = [x + back[0]! * distance, y + back[1]! * distance, z * tube.length + back[2]! * distance];
  const offset = point.map((at, i) => at - from[i]!);
  const along = (axis: number[]) => axis.reduce((sum, value, i) => sum + value * offset[i]!, 0);
  const slope = Math.tan((FIELD * Math.PI) / 360);
  return [along(right) / (-along(back) * slope * aspect), along(up) / (-along(back) * slope)];
}

test("standard views show what is kept of the tube, or its end, and fill the picture", () => {
  for (const view of STANDARD_VIEWS) {
    for (const [aspect, from, to] of [[0.5, 0, 1], [1, 0.25, 1], [1.8, 0, 0.5]] as const) {
      const placement = standardView(view, tube, { from, to }, aspect);
      const ends = view === "isthmus" ? [60 * from] : view === "ampulla" ? [60 * to] : [60 * from, 60 * to];
      const at = ends.flatMap((z) =>
        Array.from({ length: 36 }, (_, i) => seen(placement, aspect, [tube.x + 1.5 * Math.cos(i / 5.73), tube.y + 1.5 * Math.sin(i / 5.73), z])),
      );
      const most = Math.max(...at.flat().map(Math.abs));
      assert.ok(most <= 1 && most > 0.8, `${view} at ${aspect}: ${most}`);
    }
  }
});

test("lengths in the picture are those at a depth", () => {
  const camera = standardView("whole", tube, { from: 0, to: 1 }, 1.5);
  const target = { x: camera.x, y: camera.y, z: camera.z * tube.length };
  assert.ok(Math.abs(depthOf(camera, tube, target) - camera.distance) < 1e-9);
  for (const z of [0, 60]) {
    // One millimetre in the direction that points right in the picture.
    const a = (camera.azimuth * Math.PI) / 180;
    const [left, right] = [seen(camera, 1.5, [0, 0, z]), seen(camera, 1.5, [Math.cos(a), 0, z - Math.sin(a)])];
    const pixels = ((right[0] - left[0]) / 2) * 1.5 * 600;
    assert.ok(Math.abs(pixels - pixelsPerMillimetre(depthOf(camera, tube, { x: 0, y: 0, z }), 600)) < 1e-9);
  }
});

test("a link restores the view", () => {
  const view = new View(tube);
  view.pose.orbit(33.333, -7);
  view.pose.pan(0.5, 0.25, tube.length);
  view.lengthwise.value = view.across.value = view.flipped.value = view.translucent.value = view.plane.value = true;
  [view.angle.value, view.position.value, view.section.value] = [-45, 0.123456, 0.5];
  view.shown.caps.value = false;
  view.phase.value = 0.35;
  const query = writeView(view, new URLSearchParams("tab=x"));
  assert.equal(query.get("tab"), "x");
  assert.ok(query.toString().length < 120, query.toString());
  const other = new View(tube);
  readView(other, query);
  assert.equal(writeView(other, query).toString(), query.toString());
  assert.ok(Math.abs(other.pose.azimuth - view.pose.azimuth) < 0.01 && other.pose.standard === undefined);
  assert.ok(Math.abs(other.position.value - 0.12346) < 1e-9);
  assert.ok(!other.shown.caps.value && other.shown.inner.value && other.flipped.value && other.phase.value === 0.35);
});

test("a wrong link gives the view of a new page", () => {
  const view = new View(tube);
  readView(view, new URLSearchParams("cam=1_2_x&open=west&cut=7&at=&fly=-1&phase=2&hide=everything"));
  assert.equal(view.pose.standard, "whole");
  assert.ok(!view.lengthwise.value && !view.across.value && view.flight.value === undefined && view.phase.value === undefined && view.shown.inner.value);
  assert.equal(view.section.value, new View(tube).section.value);
});

test("a movement takes the short way round and ends where it should", () => {
  const { pose } = new View(tube);
  pose.place({ x: 0, y: 0, z: 0, azimuth: 170, elevation: 0, distance: 10 });
  pose.glide({ x: 0, y: 0, z: 1, azimuth: -170, elevation: 10, distance: 40 }, "side", 1000);
  pose.advance(1225);
  assert.ok(Math.abs(Math.abs(pose.azimuth) - 180) < 1e-9, `${pose.azimuth}`);
  assert.ok(Math.abs(pose.distance - 20) < 1e-9);
  pose.advance(9999);
  assert.deepEqual([pose.azimuth, pose.elevation, pose.distance, pose.z], [-170, 10, 40, 1]);
  pose.orbit(1, 0);
  pose.advance(10_100);
  assert.equal(pose.azimuth, -169);
});

test("measured points go into a link and come back; a third begins anew", () => {
  const measurement = new Measurement();
  measurement.pick({ x: 0, y: 0, z: 1 });
  assert.equal(measurement.distance.value, undefined);
  measurement.pick({ x: 0.3, y: 0.4, z: 1 });
  assert.equal(measurement.distance.value, 500);
  measurement.pick({ x: 1, y: 1, z: 1 });
  assert.equal(measurement.b.value, undefined);
  const spot = { x: 0.12345, y: -1, z: 59.99999 };
  assert.ok(distanceUm(spot, readSpot(writeSpot(spot))!) < 0.1);
  for (const wrong of [null, "", "1_2", "1_2_x", "1_2_3_4"]) assert.equal(readSpot(wrong), undefined);
});

/**
 * A box from -1 to 1 in x and y and from 0 to 10 in z, with triangles facing outwards, as one
 * patch.
 */
function box(name: Patch["name"], half = 1): Patch {
  const corners = [0, 10].flatMap((z) => [[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]]);
  const faces = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
  const positions = Float32Array.from(corners.flat());
  return {
    name,
    positions,
    straight: positions,
    normals: new Int8Array(24),
    index: Uint16Array.from(faces.flatMap(([a, b, c, d]) => [a!, b!, c!, a!, c!, d!])),
  };
}

test("the outline of a cut is closed and lies in the plane", () => {
  const segments = new Segments();
  addOutline(box("outer_wall"), { nx: 0, ny: 0, nz: -1, d: 2.5 }, segments);
  const ends = new Map<string, number>();
  let length = 0;
  for (let k = 0; k < segments.count; k++) {
    const [ax, ay, az, bx, by, bz] = segments.points.subarray(6 * k, 6 * k + 6);
    assert.ok(az === 2.5 && bz === 2.5);
    length += Math.hypot(bx! - ax!, by! - ay!);
    for (const end of [`${ax} ${ay}`, `${bx} ${by}`]) ends.set(end, (ends.get(end) ?? 0) + 1);
  }
  assert.equal(length, 8);
  assert.ok([...ends.values()].every((count) => count === 2));
});

test("segments grow and keep what they hold", () => {
  const segments = new Segments();
  for (let k = 0; k < 10_000; k++) {
    const at = segments.next();
    segments.points.fill(k, at, at + 6);
  }
  for (const k of [0, 4095, 4096, 9999]) assert.equal(segments.points[6 * k + 5], k);
  assert.equal(segments.straight, segments.points);
});

test("a ray meets the surface, a cut face of tissue, or what lies behind what is cut away", () => {
  // A tube with a square wall from 0.5 to 1. The inner box is its lumen.
  const patches = [box("outer_wall"), box("inner_wall", 0.5)];
  const all = () => true;
  const from = (x: number, y: number) => ({ ox: x, oy: y, oz: 20, dx: 0, dy: 0, dz: -1 });
  const cut = [{ nx: 0, ny: 0, nz: -1, d: 4 }];
  assert.equal(firstHit(patches, all, [], from(0.75, 0.1)), 10);
  assert.equal(firstHit(patches, all, cut, from(0.75, 0.1)), 16);
  // In the lumen there is no face, so the ray continues to its bottom.
  assert.equal(firstHit(patches, all, cut, from(0.2, 0.1)), 20);
  assert.equal(firstHit(patches, (patch) => patch.name === "outer_wall", cut, from(0.2, 0.1)), 20);
  assert.equal(firstHit(patches, all, cut, from(3, 0)), undefined);
  // The ray ignores a face that another plane has cut away.
  assert.equal(firstHit(patches, () => false, [...cut, { nx: -1, ny: 0, nz: 0, d: 0 }], from(0.75, 0.1)), undefined);
});

test("crypts are darker than the tips of folds", () => {
  const light = mucosaLight(box("inner_wall", 0.5), 10);
  assert.equal(new Set(light).size, 1);
  const folded = box("inner_wall");
  folded.positions.set([-0.2, -0.2, 0], 0);
  const [tip, crypt] = mucosaLight(folded, 10);
  assert.ok(tip === 255 && crypt! < 130);
});

test("levels: the lightest first, the best by the device", () => {
  const file = (name: string) => ({ name, media_type: "", bytes: 1, sha256: "", href: "" });
  const levels = levelsOf({ files: ["model.lod0.glb", "model.glb", "model.lod2.glb", "model.lod1.glb"].map(file) });
  assert.deepEqual(levels.map((level) => level.file.name), ["model.lod2.glb", "model.lod1.glb", "model.lod0.glb"]);
  assert.deepEqual(levelsOf({ files: [file("model.glb")] }).map((level) => level.title), ["Full"]);
  assert.deepEqual(levelsOf({ files: [file("model.obj")] }), []);
  assert.equal(automaticLevel(levels, { strength: "software", saveData: false }), 0);
  assert.equal(automaticLevel(levels, { strength: "ordinary", saveData: false }), 1);
  assert.equal(automaticLevel(levels, { strength: "strong", saveData: false }), 2);
  assert.equal(automaticLevel(levels, { strength: "strong", saveData: true }), 0);
  assert.equal(automaticLevel(levels.slice(0, 1), { strength: "strong", saveData: false }), 0);
});
