import assert from "node:assert/strict";
import { test } from "node:test";
import { bounds, evenly, roundLength, thinned } from "../src/growing/contours.ts";

/** An ellipse of `count` points that begins at an angle. */
function ellipse(count: number, begin: number, [cx, cy] = [0, 0]): Float32Array {
  const angles = Array.from({ length: count }, (_, k) => begin + (2 * Math.PI * k) / count);
  return Float32Array.from(angles.flatMap((angle) => [cx + 3 * Math.cos(angle), cy + Math.sin(angle)]));
}

test("the bounds hold all contours", () => {
  assert.deepEqual(bounds([Float32Array.of(1, 2, -3, 4), Float32Array.of(0, -5)]), { x: [-3, 1], y: [-5, 4] });
  assert.equal(bounds([]), undefined);
});

test("a thinned contour has some of the points", () => {
  const contour = Float32Array.from({ length: 20 }, (_, k) => k);
  assert.deepEqual([...thinned(contour, 4)], [0, 1, 4, 5, 10, 11, 14, 15]);
  assert.equal(thinned(contour, 10), contour);
});

test("even points are equally far apart and begin on the right, wherever the contour begins", () => {
  for (const begin of [0, 1, 3, 5]) {
    const even = evenly(ellipse(200, begin, [7, 9]), 48);
    assert.ok(Math.hypot(even[0]! - 10, even[1]! - 9) < 0.06, `begins at ${even[0]}, ${even[1]}`);
    const steps = Array.from({ length: 48 }, (_, k) => {
      const next = (k + 1) % 48;
      return Math.hypot(even[2 * next]! - even[2 * k]!, even[2 * next + 1]! - even[2 * k + 1]!);
    });
    assert.ok(Math.max(...steps) / Math.min(...steps) < 1.05, `steps ${Math.min(...steps)} to ${Math.max(...steps)}`);
  }
});

test("scale bars have round lengths", () => {
  const lengths = [7, 19.9, 20, 49, 50, 99, 1234];
  assert.deepEqual(lengths.map(roundLength), [5, 10, 20, 20, 50, 50, 1000]);
});
