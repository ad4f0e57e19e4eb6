// Bent tubes: positions of the straight tube's points, and back.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Course, isBent } from "../src/explore/course.ts";

/** A helix about z whose windings are closer to each other than twice the radius of their walls. */
export function helix({ radius = 5, pitch = 4, windings = 2, from = 0, count = 600 } = {}): Course {
  const [rise, length] = [pitch / (2 * Math.PI), windings * 2 * Math.PI * Math.hypot(radius, pitch / (2 * Math.PI))];
  const speed = Math.hypot(radius, rise);
  const points = Array.from({ length: count + 1 }, (_, k) => {
    const s = (length * k) / count;
    const [cos, sin] = [Math.cos(s / speed), Math.sin(s / speed)];
    return {
      s_mm: from + s,
      position_mm: [radius * cos, radius * sin, (rise * s) / speed],
      tangent: [(-radius * sin) / speed, (radius * cos) / speed, rise / speed],
      u: [cos, sin, 0],
      v: [(-rise * sin) / speed, (rise * cos) / speed, -radius / speed],
      curvature_per_mm: radius / speed ** 2,
    };
  });
  return new Course({
    shape: "coil", from_mm: from, to_mm: from + length, end_distance_mm: pitch * windings, tortuosity: length / (pitch * windings),
    twist_deg: 0, least_radius_mm: speed ** 2 / radius, relaxed: false, points, turns: [],
  });
}

class Triple {
  x = 0;
  y = 0;
  z = 0;
  set(x: number, y: number, z: number): void {
    [this.x, this.y, this.z] = [x, y, z];
  }
}

test("points of a cross section lie across the centre line, and straight on beyond its ends", () => {
  const course = helix({ from: 3 });
  const out = new Triple();
  course.bend(0, 0, 0, out);
  assert.deepEqual(out, Object.assign(new Triple(), { x: 5, y: 0, z: 0 }));
  course.bend(1.5, 0, 0, out);
  assert.ok(Math.hypot(out.x - 6.5, out.y, out.z) < 1e-12);
  const tangent = new Triple();
  course.turn(0, 0, 1, 0, tangent);
  assert.ok(Math.abs(Math.hypot(tangent.x, tangent.y, tangent.z) - 1) < 1e-12);
  course.bend(0, 0, -2, out);
  assert.ok(Math.hypot(out.x - 5 + 2 * tangent.x, out.y + 2 * tangent.y, out.z + 2 * tangent.z) < 1e-12);
  assert.equal(course.begin, 3);
  // Halfway between two points of the document.
  const half = course.length / 2 + course.length / 1200;
  course.bend(0, 0, half, out);
  assert.ok(Math.abs(Math.hypot(out.x, out.y) - 5) < 1e-3);
});

/** A widening tube around the centre line: rings of points, connected by triangles. */
function tube(length: number, radius: (z: number) => number, rings = 400, around = 12) {
  const points: [number, number, number][] = [];
  const index: number[] = [];
  for (let i = 0; i <= rings; i++) {
    const z = (length * i) / rings;
    for (let k = 0; k < around; k++) {
      const angle = (2 * Math.PI * k) / around;
      points.push([radius(z) * Math.cos(angle), radius(z) * Math.sin(angle), z]);
      if (i === 0) continue;
      const [a, b] = [i * around + k, i * around + ((k + 1) % around)];
      index.push(a, b, a - around, b, b - around, a - around);
    }
  }
  return { points, index };
}

test("a bent surface is made straight again, also where another part of the centre line is nearer", () => {
  // The windings are 4 mm apart, so walls 3 mm from the upper winding are 1 mm from the lower.
  const course = helix();
  const { points, index } = tube(course.length, (z) => 0.4 + (2.6 * z) / course.length);
  const [positions, out] = [new Float32Array(3 * points.length), new Triple()];
  points.forEach(([x, y, z], i) => {
    course.bend(x, y, z, out);
    positions.set([out.x, out.y, out.z], 3 * i);
  });
  // The order of triangles does not matter.
  const shuffled = Array.from({ length: index.length / 3 }, (_, t) => (t * 7919) % (index.length / 3)).flatMap((t) => index.slice(3 * t, 3 * t + 3));
  for (const order of [index, shuffled]) {
    const straight = course.straighten(positions, order);
    const off = points.map((point, i) => Math.hypot(...point.map((value, axis) => value - straight[3 * i + axis]!)));
    assert.ok(Math.max(...off) < 2e-3, `${Math.max(...off)} mm off`);
    assert.equal(straight[2], 0);
    assert.equal(straight.at(-1), Math.fround(course.length));
  }
});

test("models are bent if their spec says so", () => {
  const bent = (course?: Record<string, unknown>) => isBent({ spec: course ? { course } : {} });
  assert.deepEqual([bent(), bent({ shape: "straight", twist_deg: 0 }), bent({ shape: "arc", twist_deg: 0 }), bent({ shape: "straight", twist_deg: 90 })], [false, false, true, true]);
});
