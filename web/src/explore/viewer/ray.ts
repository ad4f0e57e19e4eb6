// Intersection of a line of sight with a surface that is partly cut away or hidden.
import type { CutPlane } from "./outline.ts";
import type { Patch } from "./surface.ts";

export interface Ray {
  ox: number;
  oy: number;
  oz: number;
  dx: number;
  dy: number;
  dz: number;
}

/**
 * Distance along the ray to the first visible point of the surface or of a cut face; undefined if
 * there is none.
 *
 * All patches together are closed. A point of a plane is therefore in tissue if an odd number of
 * triangles lies beyond it.
 */
export function firstHit(
  patches: readonly Patch[],
  visible: (patch: Patch) => boolean,
  planes: readonly CutPlane[],
  ray: Ray,
): number | undefined {
  const faces = planes.map((plane) => ({ plane, distance: distanceTo(plane, ray), beyond: 0 }));
  let nearest = Infinity;
  for (const patch of patches) {
    const seen = visible(patch);
    eachCrossing(patch.positions, patch.index, ray, (distance) => {
      for (const face of faces) if (distance > face.distance) face.beyond++;
      if (seen && distance < nearest && isKept(planes, ray, distance)) nearest = distance;
    });
  }
  for (const { plane, distance, beyond } of faces) {
    const others = planes.filter((other) => other !== plane);
    if (distance > 0 && distance < nearest && beyond % 2 === 1 && isKept(others, ray, distance)) nearest = distance;
  }
  return Number.isFinite(nearest) ? nearest : undefined;
}

/** Maximum error of positions of a cut face, millimetres. */
const ROUNDING = 1e-4;

/**
 * Like `firstHit` for a bent tube. Planes cut the straight tube, so the resulting faces are given.
 */
export function firstHitBent(
  patches: readonly Pick<Patch, "positions" | "straight" | "index">[],
  planes: readonly CutPlane[],
  ray: Ray,
): number | undefined {
  let nearest = Infinity;
  for (const { positions, straight, index } of patches) {
    eachCrossing(positions, index, ray, (distance, t, u, v) => {
      if (distance >= nearest) return;
      const [a, b, c] = [3 * index[t]!, 3 * index[t + 1]!, 3 * index[t + 2]!];
      const at = (axis: number) => straight[a + axis]! * (1 - u - v) + straight[b + axis]! * u + straight[c + axis]! * v;
      const [x, y, z] = [at(0), at(1), at(2)];
      if (planes.every(({ nx, ny, nz, d }) => nx * x + ny * y + nz * z + d >= -ROUNDING)) nearest = distance;
    });
  }
  return Number.isFinite(nearest) ? nearest : undefined;
}

function distanceTo({ nx, ny, nz, d }: CutPlane, { ox, oy, oz, dx, dy, dz }: Ray): number {
  return -(nx * ox + ny * oy + nz * oz + d) / (nx * dx + ny * dy + nz * dz);
}

function isKept(planes: readonly CutPlane[], ray: Ray, distance: number): boolean {
  return planes.every(
    ({ nx, ny, nz, d }) =>
      nx * (ray.ox + ray.dx * distance) + ny * (ray.oy + ray.dy * distance) + nz * (ray.oz + ray.dz * distance) + d >= 0,
  );
}

/**
 * Calls back with the distance of each triangle that the ray crosses from either side.
 *
 * Also passes the triangle's place in the index and the weights of its second and third corner.
 * Method: Möller and Trumbore 1997.
 */
function eachCrossing(
  p: Float32Array,
  index: ArrayLike<number>,
  { ox, oy, oz, dx, dy, dz }: Ray,
  found: (distance: number, t: number, u: number, v: number) => void,
): void {
  for (let t = 0; t < index.length; t += 3) {
    const a = 3 * index[t]!;
    const b = 3 * index[t + 1]!;
    const c = 3 * index[t + 2]!;
    const ax = p[a]!;
    const ay = p[a + 1]!;
    const az = p[a + 2]!;
    const ux = p[b]! - ax;
    const uy = p[b + 1]! - ay;
    const uz = p[b + 2]! - az;
    const vx = p[c]! - ax;
    const vy = p[c + 1]! - ay;
    const vz = p[c + 2]! - az;
    const px = dy * vz - dz * vy;
    const py = dz * vx - dx * vz;
    const pz = dx * vy - dy * vx;
    const determinant = ux * px + uy * py + uz * pz;
    if (determinant === 0) continue;
    const sx = ox - ax;
    const sy = oy - ay;
    const sz = oz - az;
    const u = (sx * px + sy * py + sz * pz) / determinant;
    if (u < 0 || u > 1) continue;
    const qx = sy * uz - sz * uy;
    const qy = sz * ux - sx * uz;
    const qz = sx * uy - sy * ux;
    const v = (dx * qx + dy * qy + dz * qz) / determinant;
    if (v < 0 || u + v > 1) continue;
    const distance = (vx * qx + vy * qy + vz * qz) / determinant;
    if (distance > 0) found(distance, t, u, v);
  }
}
