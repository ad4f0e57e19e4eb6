// Distances between two points.
import { computed, signal } from "@preact/signals";

/** A point of a model, millimetres. */
export interface Spot {
  x: number;
  y: number;
  z: number;
}

/** Distance, micrometres. */
export function distanceUm(a: Spot, b: Spot): number {
  return Math.hypot(b.x - a.x, b.y - a.y, b.z - a.z) * 1000;
}

/** A measurement of a distance on a surface. */
export class Measurement {
  /** True if taps on the surface set points. */
  readonly picking = signal(false);
  readonly a = signal<Spot | undefined>(undefined);
  readonly b = signal<Spot | undefined>(undefined);
  /** Micrometres. */
  readonly distance = computed(() => this.a.value && this.b.value && distanceUm(this.a.value, this.b.value));

  /** Sets the next point: the first, the second, then the first of a new measurement. */
  pick(spot: Spot): void {
    if (this.a.value && !this.b.value) this.b.value = spot;
    else {
      this.b.value = undefined;
      this.a.value = spot;
    }
  }

  clear(): void {
    this.a.value = undefined;
    this.b.value = undefined;
  }
}

/** `0.12_0.5_31.2`, for a link; rounded to a tenth of a micrometre. */
export function writeSpot({ x, y, z }: Spot): string {
  return [x, y, z].map((value) => String(Math.round(value * 1e4) / 1e4)).join("_");
}

export function readSpot(text: string | null): Spot | undefined {
  const numbers = text?.split("_").map(Number) ?? [];
  const [x, y, z] = numbers;
  return numbers.length === 3 && numbers.every(Number.isFinite) ? { x: x!, y: y!, z: z! } : undefined;
}
