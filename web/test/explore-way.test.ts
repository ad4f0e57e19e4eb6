// The way of the flight: positions, clearances, the camera on it, and what keeps it from beginning.
import assert from "node:assert/strict";
import { test } from "node:test";
import { PerspectiveCamera, Vector3 } from "three";
import { OviductError, type Way as WayDocument } from "../../clients/typescript/src/index.ts";
import { Course } from "../src/explore/course.ts";
import { bearing, Way } from "../src/explore/way.ts";
import { FlightCamera, FLIGHT_FIELD, nearPlane } from "../src/explore/viewer/flight-camera.ts";

type Points = WayDocument["points"];

const query = Object.assign(new EventTarget(), { matches: false });
const document = { documentElement: { dataset: {} }, baseURI: "http://127.0.0.1/" };
Object.assign(globalThis, { matchMedia: () => query, document });
const { obstacleOf } = await import("../src/explore/passage.ts");

function points(...all: [place: number, x: number, y: number, z: number, clearance: number][]): Points {
  return all.map(([s_mm, x, y, z, clearance_um], k) => {
    const [a, b] = [all[Math.max(0, k - 1)]!, all[Math.min(all.length - 1, k + 1)]!];
    const along = [1, 2, 3].map((axis) => b[axis]! - a[axis]!);
    const tangent = along.map((value) => value / Math.hypot(...along)) as [number, number, number];
    return { s_mm, position_mm: [x, y, z], tangent, clearance_um };
  });
}

function written(write: (out: Vector3) => void): number[] {
  const out = new Vector3();
  write(out);
  return out.toArray().map((value) => Math.round(value * 1e9) / 1e9 + 0);
}

test("positions lie on the polyline, in the coordinates of the picture, and end at its ends", () => {
  // A piece that begins at 10 mm of the whole tube; the picture begins at 0.
  const all = points([10.1, 0, 1, 10.1, 50], [12, 2, 1, 12, 50], [20, 2, 1, 20, 50]);
  const way = new Way({ clearance_um: 20, points: all }, { begin: 10, course: undefined });
  assert.deepEqual(written((out) => way.at(1.05, out)), [1, 1, 1.05]);
  assert.deepEqual(written((out) => way.at(-5, out)), [0, 1, 0.1]);
  assert.deepEqual(written((out) => way.at(99, out)), [2, 1, 10]);
  // At the end, the view goes on in the direction of the way.
  assert.deepEqual(written((out) => way.ahead(5, out)), [0, 0, 0.7]);
  assert.deepEqual(written((out) => way.ahead(10, out)), [0, 0, 0.7]);
});

test("a flight goes as fast sideways as along the tube", () => {
  // Sideways by 3 mm at 2 mm along the tube, where the way also goes back a little.
  const all = points([0.002, 0, 0, 0.002, 50], [2, 0, 0, 2, 50], [1.999, 3, 0, 1.999, 50], [5, 3, 0, 5, 50]);
  const way = new Way({ clearance_um: 20, points: all }, { begin: 0, course: undefined });
  const after = (place: number, millimetres: number) => Math.round(way.onward(place, millimetres) * 1e3) / 1e3;
  assert.deepEqual([after(0, 0.5), after(0.5, 1), after(1.5, 2), after(1.5, 4)], [0.502, 1.5, 2, 2.5]);
  let place = way.onward(1, 1);
  const seen: number[][] = [];
  for (let k = 0; k < 3; k++) seen.push(written((out) => way.at((place = way.onward(place, 0.75)), out)));
  assert.deepEqual(seen.map(([x]) => Math.round(x! * 100) / 100), [0.75, 1.5, 2.25]);
  assert(way.onward(4.9, 0.2) > 5, "it leaves the end");
});

test("the clearance between points is never overstated", () => {
  const all = points([0, 0, 0, 0, 100], [0.1, 0, 0, 0.1, 30], [1, 0, 0, 1, 40]);
  const way = new Way({ clearance_um: 20, points: all }, { begin: 0, course: undefined });
  const at = (place: number) => Math.round(way.clearance(place) * 1e6) / 1000;
  assert.deepEqual([at(0), at(0.02), at(0.1), at(0.5), at(1)], [100, 80, 30, 20, 40]);
});

test("the near plane is in front of every wall, and not too near for the depths", () => {
  for (const aspect of [0.46, 1, 1.6, 2.4]) {
    for (const clearance of [0.01, 0.023, 0.045, 0.2]) {
      const near = nearPlane(clearance, 0.004, aspect);
      const slope = Math.tan((FLIGHT_FIELD * Math.PI) / 360);
      const corner = near * Math.hypot(1, slope, slope * aspect);
      assert.ok(near >= 0.001 && corner <= clearance - 0.004, `${near} at ${clearance}`);
    }
  }
  assert.equal(nearPlane(0.01, 0.05, 1), 0.001);
  assert.equal(nearPlane(9, 0, 1), 0.02);
});

/** A quarter circle with a radius of 10 mm, from the origin along z, toward x. */
const course = new Course({
  shape: "arc", from_mm: 0, to_mm: 5 * Math.PI, end_distance_mm: 14, tortuosity: 1.11, twist_deg: 0,
  least_radius_mm: 10, relaxed: false, turns: [],
  points: Array.from({ length: 401 }, (_, k) => {
    const [cos, sin] = [Math.cos((Math.PI * k) / 800), Math.sin((Math.PI * k) / 800)];
    return {
      s_mm: (10 * Math.PI * k) / 800, position_mm: [10 - 10 * cos, 0, 10 * sin],
      tangent: [sin, 0, cos], u: [cos, 0, -sin], v: [0, 1, 0], curvature_per_mm: 0.1,
    };
  }),
});

test("the camera looks along the way without sudden turns, and keeps its vertical", () => {
  const tube = { begin: 0, length: 5 * Math.PI, radius: 1.5, x: 0, y: 0, course };
  // A way that winds about the centre line, and goes aside steeply in the middle.
  const all = Array.from({ length: 161 }, (_, k): [number, number, number, number, number] => {
    const place = (tube.length * k) / 160;
    const [u, v] = [0.3 * Math.sin(place), (k > 80 ? 0.6 : 0) + 0.3 * Math.cos(3 * place)];
    const [x, y, z] = written((out) => course.bend(u, v, place, out));
    return [place, x!, y!, z!, 40];
  });
  const way = new Way({ clearance_um: 20, points: points(...all) }, tube);
  const camera = new PerspectiveCamera();
  const flight = new FlightCamera(tube);
  const [before, now, axis, up] = [new Vector3(), new Vector3(), new Vector3(), new Vector3()];
  for (let place = 0; place <= tube.length; place += 0.01) {
    flight.place(camera, way, place);
    camera.getWorldDirection(now);
    course.turn(0, 0, 1, place, axis);
    assert.ok(now.dot(axis) > 0.3, `across the tube at ${place} mm`);
    up.set(0, 1, 0).applyQuaternion(camera.quaternion);
    assert.ok(up.y > 0.3, `upside down at ${place} mm`);
    if (place > 0) assert.ok(now.angleTo(before) < 0.05, `turns by ${now.angleTo(before)} at ${place} mm`);
    before.copy(now);
  }
});

test("the camera in the plane of a cut", () => {
  const piece = { begin: 10, course: undefined };
  const way = new Way({ clearance_um: 20, points: points([10, 0.1, 0.2, 10, 50], [20, 0.3, 0.2, 20, 50]) }, piece);
  const across = { origin_um: [0, 0, 15_000], normal: [0, 0, 1], u: [1, 0, 0], v: [0, 1, 0] };
  const straight = bearing(way, piece, 5, across);
  assert.deepEqual([Math.round(straight.u), Math.round(straight.v), straight.up], [200, 200, [0, 1]]);
  // At half of the arc, 0.5 mm outside and 0.2 mm above the centre line.
  const [half, out] = [Math.SQRT1_2, 10.5 * Math.SQRT1_2];
  const bent = { begin: 0, course };
  const all = points([7, 10 - out, 0.2, out, 50], [8.708, 10 - out, 0.2, out, 50]);
  const { u, v, up } = bearing(new Way({ clearance_um: 20, points: all }, bent), bent, 2.5 * Math.PI, {
    origin_um: [10_000 - 10_000 * half, 0, 10_000 * half], normal: [half, 0, half], u: [half, 0, -half], v: [0, 1, 0],
  });
  assert.deepEqual([u, v, ...up].map(Math.round), [-500, 200, 0, 1]);
});

test("some problems end the search for a way, others may pass", () => {
  const problem = (status: number, slug: string, detail: string) => {
    const type = `urn:oviduct:problem:${slug}` as NonNullable<OviductError["problem"]>["type"];
    const body = { type, title: slug, status, detail } as NonNullable<OviductError["problem"]>;
    return new OviductError(new Response(null, { status }), body);
  };
  const state = (status: number, slug: string) => obstacleOf(problem(status, slug, "It is so.")).state;
  for (const [status, slug] of [[404, "file-not-found"], [422, "surface-too-large"], [404, "way-not-found"]] as const) {
    assert.equal(state(status, slug), "none");
  }
  assert.deepEqual([state(503, "too-many-pictures"), state(500, "internal")], ["failed", "failed"]);
  const closed = "The lumen is closed at 3.1 mm.";
  assert.equal(obstacleOf(problem(404, "way-not-found", closed)).words, closed);
  assert.equal(obstacleOf(new TypeError("no network")).state, "failed");
});
