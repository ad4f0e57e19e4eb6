// Sections in the explorer: contours, the distance to the mucosa, the path through the lumen.
import assert from "node:assert/strict";
import { test } from "node:test";
import { centreline, positionAt } from "../src/explore/centreline.ts";
import { area, boundsOf, contains, nearest, pathData, perimeter, type Outline } from "../src/explore/contours.ts";
import { nearestIndex } from "../src/explore/ascending.ts";
import { DistanceField } from "../src/explore/lumen.ts";
import { distanceOf, nearestPoint } from "../src/explore/section-points.ts";

const square: Outline = { x: [0, 10, 10, 0], y: [0, 0, 10, 10] };

const noPause = () => Promise.resolve();

/**
 * A lumen of two round rooms of 60 µm with a passage between them.
 *
 * `open` is the larger room: -1 at the left, 1 at the right.
 */
function rooms(open: -1 | 1): Outline {
  const [x, y]: [number[], number[]] = [[], []];
  const room = (centre: number, radius: number, from: number) => {
    for (let i = 0; i <= 40; i++) {
      const turn = from + (i / 40) * 2 * Math.PI * 0.95 + 0.05 * Math.PI;
      x.push(centre + radius * Math.cos(turn));
      y.push(radius * Math.sin(turn));
    }
  };
  room(100, open === 1 ? 60 : 30, Math.PI);
  room(-100, open === 1 ? 30 : 60, 0);
  return { x, y };
}

test("area, perimeter and bounds of a square", () => {
  assert.equal(area(square), 100);
  assert.equal(area({ x: [...(square.x as number[])].reverse(), y: [...(square.y as number[])].reverse() }), -100);
  assert.equal(perimeter(square), 40);
  assert.deepEqual(boundsOf(square), { x0: 0, y0: 0, x1: 10, y1: 10 });
  assert.equal(pathData(square), "M0 0L10 0L10 10L0 10Z");
});

test("points are inside by the even-odd rule, in a notch they are not", () => {
  const notched: Outline = { x: [0, 10, 10, 5, 0], y: [0, 0, 10, 2, 10] };
  assert.ok(contains(square, 5, 8));
  assert.ok(!contains(notched, 5, 8));
  assert.ok(contains(notched, 5, 1));
  assert.ok(!contains(notched, -1, 5));
});

test("the nearest point of a contour", () => {
  assert.deepEqual(nearest(square, 11, 12), { index: 2, distance: Math.hypot(1, 2) });
});

test("the distance field agrees with the exact distance to a polygon", () => {
  const outline: Outline = { x: [0, 200, 200, 120, 120, 80, 80, 0], y: [0, 0, 100, 100, 20, 20, 100, 100] };
  const field = new DistanceField(outline, 200);
  const exact = (px: number, py: number) => {
    let least = Infinity;
    for (let i = 0, j = outline.x.length - 1; i < outline.x.length; j = i++) {
      const [ax, ay, bx, by] = [outline.x[j]!, outline.y[j]!, outline.x[i]!, outline.y[i]!];
      const t = Math.max(0, Math.min(1, ((px - ax) * (bx - ax) + (py - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)));
      least = Math.min(least, Math.hypot(px - ax - (bx - ax) * t, py - ay - (by - ay) * t));
    }
    return contains(outline, px, py) ? least : -least;
  };
  for (let i = 0; i < 500; i++) {
    const [px, py] = [(i * 73.13) % 200, (i * 37.77) % 100];
    const error = Math.abs(field.sample(px, py) - exact(px, py));
    assert.ok(error < 1.5 * field.cell, `${error} µm at ${px}, ${py}`);
  }
});

test("the way stays in the lumen while the open room changes sides", async () => {
  const z = Array.from({ length: 30 }, (_, k) => 300 * k);
  const outlines = z.map((_, k) => rooms(k < 15 ? -1 : 1));
  const way = await centreline(outlines.map((outline) => new DistanceField(outline)), z, noPause);
  assert.ok(way.x[0]! < -0.08 && way.x[29]! > 0.08, "it begins and ends in the large rooms");
  outlines.forEach((outline, k) => assert.ok(contains(outline, way.x[k]! * 1000, way.y[k]! * 1000), `section ${k}`));
  assert.ok(Math.min(...way.clearance) > 0);
});

test("the way goes straight where the widest place jumps between equal ones", async () => {
  // Two equal rooms; noise makes either of them the wider one.
  const z = Array.from({ length: 20 }, (_, k) => 300 * k);
  const fields = z.map((_, k) => {
    const { x, y } = rooms(1);
    const wider = k % 2 === 0 ? 1.02 : 0.98;
    return new DistanceField({ x: Array.from(x, (at) => (at > 0 ? at : at * 2 * wider)), y: Array.from(y, (at, i) => (x[i]! > 0 ? at : at * 2 * wider)) });
  });
  const { x } = await centreline(fields, z, noPause);
  const signs = new Set(Array.from(x, Math.sign));
  assert.equal(signs.size, 1);
});

test("a position between two sections, and beyond the ends", () => {
  const line = { x: Float64Array.of(0, 2), y: Float64Array.of(1, 1), z: Float64Array.of(0, 4), clearance: Float64Array.of(1, 1) };
  const at = (z: number) => {
    let result: number[] = [];
    positionAt(line, z, { set: (...xyz) => (result = xyz) });
    return result;
  };
  assert.deepEqual(at(1), [0.5, 1, 1]);
  assert.deepEqual(at(-1), [0, 1, 0]);
  assert.deepEqual(at(9), [2, 1, 4]);
});

test("the nearest of ascending values", () => {
  const values = [0, 1, 3, 7];
  assert.deepEqual([-5, 0.4, 0.6, 2.1, 5.1, 90].map((value) => nearestIndex(values, value)), [0, 0, 1, 2, 3, 3]);
});

test("a distance in a section is that of the stored numbers", () => {
  const contours = [{ x: Float32Array.of(-50, 50), y: Float32Array.of(0, 0) }, { x: Float32Array.of(0.1, 3.3), y: Float32Array.of(0.2, 4.7) }];
  const [a, b] = [nearestPoint(contours, 0, 0), nearestPoint(contours, 60, 5)];
  assert.deepEqual([a, b], [{ contour: 1, index: 0 }, { contour: 0, index: 1 }]);
  assert.equal(distanceOf(contours, a, b), Math.hypot(50 - Math.fround(0.1), -Math.fround(0.2)));
});
