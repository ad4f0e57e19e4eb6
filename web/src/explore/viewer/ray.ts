// Where a line of sight meets a surface of which parts are cut away or hidden.
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
 * Distance along the ray to the first visible point of the surface, or of a face that a plane has cut into its tissue;
 * undefined if there is none. All patches together are closed, so a point of a plane is in tissue if an odd number of
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
    eachCrossing(patch, ray, (distance) => {
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

function distanceTo({ nx, ny, nz, d }: CutPlane, { ox, oy, oz, dx, dy, dz }: Ray): number {
  return -(nx * ox + ny * oy + nz * oz + d) / (nx * dx + ny * dy + nz * dz);
}

function isKept(planes: readonly CutPlane[], ray: Ray, distance: number): boolean {
  return planes.every(
    ({ nx, ny, nz, d }) =>
      nx * (ray.ox + ray.dx * distance) + ny * (ray.oy + ray.dy * distance) + nz * (ray.oz + ray.dz * distance) + d >= 0,
  );
}

/** Calls back with the distance of each triangle that the ray crosses, from either side (Möller, Trumbore 1997). */
function eachCrossing({ positions: p, index }: Patch, { ox, oy, oz, dx, dy, dz }: Ray, found: (distance: number) => void): void {
  for (let t = 0; t < index.length; t += 3) {
    const [a, b, c] = [3 * index[t]!, 3 * index[t + 1]!, 3 * index[t + 2]!];
    const [ax, ay, az] = [p[a]!, p[a + 1]!, p[a + 2]!];
    const [ux, uy, uz] = [p[b]! - ax, p[b + 1]! - ay, p[b + 2]! - az];
    const [vx, vy, vz] = [p[c]! - ax, p[c + 1]! - ay, p[c + 2]! - az];
    const [px, py, pz] = [dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx];
    const determinant = ux * px + uy * py + uz * pz;
    if (determinant === 0) continue;
    const [sx, sy, sz] = [ox - ax, oy - ay, oz - az];
    const u = (sx * px + sy * py + sz * pz) / determinant;
    if (u < 0 || u > 1) continue;
    const [qx, qy, qz] = [sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux];
    const v = (dx * qx + dy * qy + dz * qz) / determinant;
    if (v < 0 || u + v > 1) continue;
    const distance = (vx * qx + vy * qy + vz * qz) / determinant;
    if (distance > 0) found(distance);
  }
}
