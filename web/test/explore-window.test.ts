// The shown part of a section's drawing.
import assert from "node:assert/strict";
import { test } from "node:test";
import { dragged, pointAt, windowOf, zoomed } from "../src/explore/section-window.ts";

/** Pixels. */
const SIDE = 400;
const whole = windowOf({ x0: -500, y0: 0, x1: 500, y1: 800 });

test("a whole section is shown with a margin", () => {
  assert.deepEqual([whole.x, whole.y], [0, 400]);
  assert.ok(whole.span > 1000 && whole.span < 1200, `${whole.span}`);
});

test("what is dragged or zoomed at stays under the pointer", () => {
  const at = pointAt(whole, 100, 300, SIDE);
  assert.ok(at.x < whole.x && at.y < whole.y, "left of the middle and below it");
  const near = (point: { x: number; y: number }) => Math.hypot(point.x - at.x, point.y - at.y) < 1e-9;
  const closer = zoomed(whole, 0.25, at, whole);
  assert.equal(closer.span, whole.span / 4);
  assert.ok(near(pointAt(closer, 100, 300, SIDE)));
  assert.ok(near(pointAt(dragged(closer, 30, -50, SIDE), 130, 250, SIDE)));
  assert.ok(near(pointAt(zoomed(closer, 2, at, whole), 100, 300, SIDE)));
});

test("zoom ends at the whole section and at 10 µm", () => {
  const corner = pointAt(whole, 0, 0, SIDE);
  const closer = zoomed(whole, 0.5, corner, whole);
  assert.notDeepEqual([closer.x, closer.y], [whole.x, whole.y]);
  assert.equal(zoomed(closer, 2, corner, whole), whole);
  assert.equal(zoomed(closer, 5, corner, whole), whole);
  assert.equal(zoomed(closer, 1e-6, corner, whole).span, 10);
});
