// Bent tubes in the 3D view: faces of cuts, picked points, and views.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Course } from "../src/explore/course.ts";
import { openingAngle, reachOf, standardView, type Tube } from "../src/explore/framing.ts";
import { View, readView, writeView } from "../src/explore/view.ts";
import { fill } from "../src/explore/viewer/fill.ts";
import { addOutline, Segments } from "../src/explore/viewer/outline.ts";
import { firstHitBent } from "../src/explore/viewer/ray.ts";
import type { Patch } from "../src/explore/viewer/surface.ts";
import { courseInWords } from "../src/explore/words.ts";

/** A quarter circle with a radius of 10 mm, from the origin along z, toward x. */
const COUNT = 200;
const RADIUS = 10;
const LENGTH = (RADIUS * Math.PI) / 2;
const course = new Course({
  shape: "arc", from_mm: 0, to_mm: LENGTH, end_distance_mm: RADIUS * Math.SQRT2, tortuosity: Math.PI / (2 * Math.SQRT2),
  twist_deg: 0, least_radius_mm: RADIUS, relaxed: false, turns: [],
  points: Array.from({ length: COUNT + 1 }, (_, k) => {
    const a = (Math.PI * k) / (2 * COUNT);
    const [cos, sin] = [Math.cos(a), Math.sin(a)];
    return {
      s_mm: RADIUS * a, position_mm: [RADIUS * (1 - cos), 0, RADIUS * sin], tangent: [sin, 0, cos], u: [cos, 0, -sin], v: [0, 1, 0], curvature_per_mm: 1 / RADIUS,
    };
  }),
});
const tube: Tube = { begin: 0, length: LENGTH, radius: 1.5, x: 0, y: 0, course };

/** A wall with a square cross section of half side `half`, as fine as the course. */
function wall(name: Patch["name"], half: number, rings = 120): Patch {
  const straight: number[] = [];
  const index: number[] = [];
  for (let i = 0; i <= rings; i++) {
    for (const [x, y] of [[-half, -half], [half, -half], [half, half], [-half, half]] as const) straight.push(x, y, (LENGTH * i) / rings);
    for (let k = 0; k < 4 && i > 0; k++) {
      const [a, b] = [4 * i + k, 4 * i + ((k + 1) % 4)];
      index.push(a, b, a - 4, b, b - 4, a - 4);
    }
  }
  const positions = new Float32Array(straight.length);
  for (let i = 0; i < straight.length; i += 3) {
    course.bend(straight[i]!, straight[i + 1]!, straight[i + 2]!, { set: (x, y, z) => positions.set([x, y, z], i) });
  }
  return { name, positions, straight: Float32Array.from(straight), normals: new Int8Array(straight.length), index: Uint32Array.from(index) };
}

/** Outer and inner wall: the tissue lies between 0.5 and 1.5 mm. */
const walls = [wall("outer_wall", 1.5), wall("inner_wall", 0.5)];

function areaOf({ positions, index }: { positions: Float32Array; index: ArrayLike<number> }): number {
  let area = 0;
  const at = (i: number, axis: number) => positions[3 * index[i]! + axis]!;
  for (let t = 0; t < index.length; t += 3) {
    const [a, b] = [1, 2].map((k) => [0, 1, 2].map((axis) => at(t + k, axis) - at(t, axis))) as [number[], number[]];
    area += Math.hypot(a[1]! * b[2]! - a[2]! * b[1]!, a[2]! * b[0]! - a[0]! * b[2]!, a[0]! * b[1]! - a[1]! * b[0]!) / 2;
  }
  return area;
}

function outlines(plane: { nx: number; ny: number; nz: number; d: number }): Segments[] {
  return walls.map((patch) => {
    const segments = new Segments(true);
    addOutline(patch, plane, segments);
    return segments;
  });
}

test("the face of a cut along the centre line is the tissue on both sides of the lumen", () => {
  const face = fill(outlines({ nx: 0, ny: 1, nz: 0, d: 0 }), [1, 0, 0], [0, 0, 1]);
  // In the plane of the arc, the face is a quarter of two rings.
  const expected = (Math.PI / 4) * (11.5 ** 2 - 10.5 ** 2 + 9.5 ** 2 - 8.5 ** 2);
  assert.ok(Math.abs(areaOf(face) / expected - 1) < 1e-3, `${areaOf(face)} and not ${expected}`);
  for (let i = 0; i < face.straight.length; i += 3) {
    assert.ok(Math.abs(face.positions[i + 1]!) < 1e-6);
    const x = Math.abs(face.straight[i]!);
    assert.ok(x > 0.499 && x < 1.501);
  }
});

test("the face of a cut across is a plane of tissue around the lumen, wherever the tube points", () => {
  const face = fill(outlines({ nx: 0, ny: 0, nz: -1, d: 7 }), [1, 0, 0], [0, 1, 0]);
  assert.ok(Math.abs(areaOf(face) - 8) < 1e-3, `${areaOf(face)} mm²`);
  const points = Array.from({ length: face.positions.length / 3 }, (_, i) => face.positions.subarray(3 * i, 3 * i + 3));
  let [tangent, centre] = [[0, 0, 0], [0, 0, 0]];
  course.turn(0, 0, 1, 7, { set: (...values) => (tangent = values) });
  course.bend(0, 0, 7, { set: (...values) => (centre = values) });
  for (const point of points) assert.ok(Math.abs([0, 1, 2].reduce((sum, k) => sum + (point[k]! - centre[k]!) * tangent[k]!, 0)) < 1e-3);
});

test("nothing is filled where nothing is cut", () => {
  assert.equal(fill(outlines({ nx: 0, ny: 0, nz: -1, d: -1 }), [1, 0, 0], [0, 1, 0]).index.length, 0);
});

test("a ray meets a bent wall, the face of a cut, or what lies behind what is cut away", () => {
  const normals = new Int8Array();
  const cut = { nx: 0, ny: -1, nz: 0, d: 0 };
  const face = { ...fill(outlines(cut), [1, 0, 0], [0, 0, 1]), normals };
  // From above, in the middle of the arc.
  const from = (radius: number) => ({ ox: RADIUS - radius * Math.SQRT1_2, oy: 20, oz: radius * Math.SQRT1_2, dx: 0, dy: -1, dz: 0 });
  const near = (distance: number | undefined, expected: number) => assert.ok(Math.abs(distance! - expected) < 2e-3, `${distance} and not ${expected}`);
  near(firstHitBent(walls, [], from(9)), 18.5);
  near(firstHitBent([...walls, face], [cut], from(9)), 20);
  // Through the lumen to its floor.
  near(firstHitBent([...walls, face], [cut], from(10)), 20.5);
  assert.equal(firstHitBent([...walls, face], [cut], from(13)), undefined);
});

test("ends are looked on to, and the whole from where it is broadest", () => {
  const isthmus = standardView("isthmus", tube, { from: 0, to: 1 }, 1.5);
  assert.deepEqual([Math.abs(isthmus.azimuth), isthmus.elevation, isthmus.x, isthmus.y, isthmus.z].map((value) => Math.round(value * 1e6) / 1e6 + 0), [180, 0, 0, 0, 0]);
  // The other end points to x.
  const ampulla = standardView("ampulla", tube, { from: 0, to: 1 }, 1.5);
  assert.deepEqual([ampulla.azimuth, ampulla.x, ampulla.z * LENGTH].map(Math.round), [90, 10, 10]);
  // The kept part ends at half of the turn.
  assert.equal(Math.round(standardView("ampulla", tube, { from: 0, to: 0.5 }, 1.5).azimuth), 45);
  // The arc lies in the plane y = 0.
  const whole = standardView("whole", tube, { from: 0, to: 1 }, 1.5);
  assert.ok(whole.elevation >= 45, `from ${whole.elevation}°`);
  // With this cut, the lumen is visible from above.
  assert.ok(Math.abs(openingAngle(tube, course, 1.5) + 90) <= 45);
  assert.deepEqual(reachOf(tube).map((value) => Math.round(value * 1e3)), [0, 637]);
  assert.deepEqual(reachOf({ ...tube, course: undefined }), [0, 1]);
});

test("two tubes with viewpoints of their own are moved together, and both are in the link", () => {
  const view = new View({ ...tube, course: undefined }, tube);
  const [first, second] = view.viewpoints.map(({ pose }) => pose);
  view.show("ampulla");
  assert.deepEqual([first!.azimuth, Math.round(second!.azimuth)], [0, 90]);
  assert.deepEqual([writeView(view, new URLSearchParams()).get("cam"), writeView(view, new URLSearchParams()).get("cam2")], ["ampulla", "ampulla"]);
  view.orbit(10, 5);
  view.zoom(0.5);
  view.pan(0.1, 0, tube);
  assert.deepEqual([first!.azimuth, Math.round(second!.azimuth)], [10, 100]);
  const other = new View({ ...tube, course: undefined }, tube);
  readView(other, writeView(view, new URLSearchParams()));
  for (const [k, { pose }] of other.viewpoints.entries()) {
    const { azimuth, elevation, distance } = view.viewpoints[k]!.pose;
    for (const [value, expected] of [[pose.azimuth, azimuth], [pose.elevation, elevation], [pose.distance, distance]] as const) assert.ok(Math.abs(value / expected - 1) < 1e-3);
  }
});

test("how a tube runs is said in a line", () => {
  assert.equal(courseInWords(course), "The tube follows a centre line of tortuosity 1.11 with ends 14.1 mm apart.");
  assert.equal(courseInWords({ tortuosity: 1, endDistance: 60, turned: 90, isStraight: true }), "The tube is straight and turned by 90° about its centre line.");
  assert.equal(courseInWords(undefined), "The tube is straight.");
});
