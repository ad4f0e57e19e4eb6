// Brightness of the mucosa: crypts between folds are darker than the tips of folds.
import type { Patch } from "./surface.ts";

const BINS = 240;
/** Brightness of the deepest crypts. */
const DARKEST = 0.42;

/**
 * Brightness of each vertex of the inner wall, 0 to 255.
 *
 * It depends on the vertex's place between the innermost fold tip and the deepest crypt of its
 * stretch of the tube. This approximates ambient occlusion without any cost while drawing.
 */
export function mucosaLight({ straight: positions }: Patch, length: number): Uint8Array<ArrayBuffer> {
  const count = positions.length / 3;
  const deepest = new Float32Array(BINS);
  const innermost = new Float32Array(BINS).fill(Infinity);
  const bin = (i: number) => Math.max(0, Math.min(BINS - 1, Math.floor((positions[3 * i + 2]! / length) * BINS)));
  const radius = (i: number) => Math.hypot(positions[3 * i]!, positions[3 * i + 1]!);
  for (let i = 0; i < count; i++) {
    const [k, r] = [bin(i), radius(i)];
    deepest[k] = Math.max(deepest[k]!, r);
    innermost[k] = Math.min(innermost[k]!, r);
  }
  const light = new Uint8Array(count);
  for (let i = 0; i < count; i++) {
    const k = bin(i);
    const depth = (radius(i) - innermost[k]!) / Math.max(deepest[k]! - innermost[k]!, 1e-6);
    light[i] = Math.round(255 * (1 - (1 - DARKEST) * depth * depth));
  }
  return light;
}
