// Sections in the explorer: contours, and distances between their points.
import assert from "node:assert/strict";
import { test } from "node:test";
import { area, boundsOf, contains, nearest, pathData, thinned, type Outline } from "../src/explore/contours.ts";
import { nearestIndex } from "../src/explore/ascending.ts";
import { placesIn, placesOf } from "../src/explore/places.ts";
import { distanceOf, nearestPoint } from "../src/explore/section-points.ts";

const square: Outline = { x: [0, 10, 10, 0], y: [0, 0, 10, 10] };

test("area and bounds of a square", () => {
  assert.equal(area(square), 100);
  assert.equal(area({ x: [...(square.x as number[])].reverse(), y: [...(square.y as number[])].reverse() }), -100);
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

test("an outline for a small picture has no points that are closer than a step", () => {
  const circle = Array.from({ length: 628 }, (_, i) => i / 100);
  const { x, y } = thinned({ x: circle.map(Math.cos), y: circle.map(Math.sin) }, 0.1);
  assert.ok(x.length > 50 && x.length < 64, `${x.length} points`);
  assert.ok(Math.abs(area({ x, y }) / Math.PI - 1) < 0.01);
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

test("the places of the sections are those of the report, if it lists every section", () => {
  type Given = Parameters<typeof placesOf>[0];
  const along = { z_mm: [0, 1, 2], step: [0, 10, 20] };
  const report = (given: object, summary: object = { sections: 3 }) => placesOf({ summary, ...given } as Given);
  assert.deepEqual(report({ morphometry: { along }, simulated: null }), along);
  // The cuts of a leaning surface do not lie at its sections.
  assert.deepEqual(report({ morphometry: { along: { z_mm: [0.5] } }, simulated: { along } }), along);
  assert.equal(report({}), undefined);
  assert.equal(report({ morphometry: { along: { z_mm: [0, 1, 2] } } }), undefined);
  assert.equal(report({ morphometry: { along } }, { sections: 3, sections_added: 1 }), undefined);
  assert.equal(report({ morphometry: { along } }, { sections: 4 }), undefined);
  const entries = [0, 500].map((z_um, index) => {
    return { index, z_um, step: 2.5 * index, added: false, innerPoints: 0, outerPoints: 0 };
  });
  assert.deepEqual(placesIn({ entries }), { z_mm: [0, 0.5], step: [0, 2.5] });
});
