// Parts that the picture omits during movements: pixels, and triangles that cannot be visible.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Resolution } from "../src/explore/viewer/resolution.ts";
import { around, seenThroughEnds, select, type Stretch } from "../src/explore/viewer/sight.ts";

Object.assign(globalThis, { devicePixelRatio: 1 });

/** Draws frames at intervals in milliseconds; returns the last time. */
function draw(resolution: Resolution, count: number, interval: number, from = 0): number {
  for (let k = 1; k <= count; k++) resolution.frame(from + k * interval);
  return from + count * interval;
}

test("a slow movement is drawn coarsely, and sharply once it rests", (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  let rests = 0;
  const resolution = new Resolution(false, () => rests++);
  let now = draw(resolution, 20, 40);
  assert.deepEqual([resolution.coarse, resolution.ratio], [false, 1]);
  now = draw(resolution, 20, 60, now);
  assert.deepEqual([resolution.coarse, resolution.ratio], [true, 0.5]);
  // Between the two limits nothing changes, so the picture does not flicker.
  now = draw(resolution, 100, 20, now);
  assert(resolution.coarse);
  assert.equal(rests, 0);
  context.mock.timers.tick(1000);
  assert.equal(rests, 1);
  resolution.frame(now + 1000);
  assert.deepEqual([resolution.coarse, resolution.ratio], [false, 1]);
  // The next movement is coarse from its first frame, until the device proves fast.
  now = draw(resolution, 1, 20, now + 2000);
  assert(resolution.coarse);
  draw(resolution, 20, 8, now);
  assert(!resolution.coarse);
  resolution.dispose();
});

test("without a graphics processor a movement begins coarsely, and a picture at rest is larger than the page", (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const resolution = new Resolution(true, () => {});
  resolution.frame(1000);
  assert.deepEqual([resolution.coarse, resolution.ratio], [true, 0.5]);
  context.mock.timers.tick(1000);
  resolution.frame(2000);
  assert.deepEqual([resolution.coarse, resolution.ratio], [false, 1.5]);
  // A continuing movement is not a picture at rest, however long its frame takes.
  draw(resolution, 1, 20, 2000);
  context.mock.timers.tick(1000);
  resolution.moved();
  resolution.frame(3000);
  assert(resolution.coarse);
  resolution.dispose();
});

const TUBE = { begin: 0, length: 60, radius: 1.5, x: 0, y: 0 };

test("from outside one sees into an open end as far as a line of sight reaches within the tube", () => {
  const seen = (x: number, z: number, ends: Stretch = { from: 0, to: TUBE.length }): Stretch => {
    const out = { from: 0, to: 0 };
    seenThroughEnds({ x, y: 0, z }, TUBE, ends, out);
    return out;
  };
  /** Fails if a line of sight through an end leaves the tube beyond the computed stretch. */
  const covers = (x: number, z: number, end: number) => {
    const { from, to } = seen(x, z);
    for (const entry of [-1.5, 0, 1.5]) {
      // The point where the line of sight leaves the tube on the other side.
      const at = end + ((Math.sign(entry - x) * 1.5 - entry) / (entry - x)) * (end - z);
      const last = Math.max(0, Math.min(TUBE.length, at));
      assert(from <= last && last <= to, `${last} from (${x}, ${z})`);
    }
  };
  for (const x of [-80, -10, 4, 30]) {
    for (const beyond of [1, 20, 90]) {
      covers(x, -beyond, 0);
      covers(x, 60 + beyond, 60);
    }
  }
  // From the side, neither end is visible. From in front of an end or from inside, everything is.
  assert(seen(1, 30).from <= 0 && seen(1, 30).to >= 60);
  assert(seen(50, 30).to < 0);
  assert(seen(0, 100).from < 0 && seen(0, 100).to > 60);
  const cut = seen(40, 100, { from: 0, to: 36 });
  assert(cut.from > 24 && cut.to >= 36 && cut.to < 40, JSON.stringify(cut));
});

test("a stretch around a camera changes seldom and holds its surroundings", () => {
  const out = { from: 0, to: 0 };
  const seen = new Set<number>();
  for (let z = 0; z < 60; z += 0.01) {
    around(z, 1.8, TUBE, out);
    assert(out.from <= z - 1.8 && out.to >= z + 1.8);
    seen.add(out.from);
  }
  assert(seen.size < 30, `${seen.size} stretches`);
});

test("triangles wholly behind a plane are left out", () => {
  // Four triangles in a row along x, each 1 wide.
  const positions = Float32Array.from([0, 0, 0, 1, 0, 0, 0, 1, 0, 2, 0, 0, 3, 0, 0, 2, 1, 0]);
  const index = Uint16Array.from([0, 1, 2, 3, 4, 5, 0, 4, 5]);
  const patch = { name: "outer_wall" as const, positions, straight: positions, normals: new Int8Array(), index };
  const out = new Uint16Array(index.length);
  const left = (...planes: { nx: number; ny: number; nz: number; d: number }[]) => [...out.subarray(0, select(patch, planes, out))];
  assert.deepEqual(left(), [...index]);
  assert.deepEqual(left({ nx: 1, ny: 0, nz: 0, d: -1.5 }), [3, 4, 5, 0, 4, 5]);
  assert.deepEqual(left({ nx: -1, ny: 0, nz: 0, d: 1.5 }), [0, 1, 2, 0, 4, 5]);
  // One corner is behind one plane, and the rest is behind the other plane.
  assert.deepEqual(left({ nx: 1, ny: 0, nz: 0, d: -1.5 }, { nx: -1, ny: 0, nz: 0, d: 1.5 }), [0, 4, 5]);
  // Nothing lies beside a plane at infinity.
  assert.deepEqual(left({ nx: 0, ny: 0, nz: 1, d: Infinity }, { nx: 0, ny: 0, nz: -1, d: Infinity }), [...index]);
  assert.deepEqual(left({ nx: 0, ny: 0, nz: 1, d: -Infinity }), []);
});
