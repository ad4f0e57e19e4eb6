// The contraction of a model: loads its animation on request, plays it, and seeks in it.
import { batch, computed, effect, signal } from "@preact/signals";
import type { Model, ModelFile } from "oviduct-client";
import { ask, explain } from "../service.ts";
import { stillness } from "../ui/theme.ts";
import type { Tube } from "./framing.ts";
import type { View } from "./view.ts";
import { readMotion, type Motion } from "./viewer/motion.ts";

/** Milliseconds between updates of the controls and the link while the animation plays. */
const TOLD = 100;

export class Contraction {
  /** The animation file, if the model has one. */
  readonly file: ModelFile | undefined;
  readonly motion = signal<Motion | undefined>(undefined);
  /** Number of bytes received while the animation loads. */
  readonly loading = signal<number | undefined>(undefined);
  /** Reason why loading failed. */
  readonly fault = signal<string | undefined>(undefined);
  readonly playing = signal(false);
  /** The motion, while it is shown instead of the tube at rest. */
  readonly shown = computed(() => (this.#asked.value ? this.motion.value : undefined));
  /** Time for the controls, as a fraction of the period. */
  readonly phase = signal(0);
  /** Called after the motion has changed the surface. */
  onMove: (() => void) | undefined;
  readonly #asked = computed(() => this.#view.phase.value !== undefined);
  readonly #model: Model;
  readonly #view: View;
  readonly #tube: Tube;
  readonly #abort = new AbortController();
  #last = 0;
  #told = 0;
  #at = 0;
  readonly #leave: (() => void)[];

  constructor(model: Model, view: View, tube: Tube) {
    this.file = model.files.find(({ name }) => name === "animation.glb");
    this.#model = model;
    this.#view = view;
    this.#tube = tube;
    const load = effect(() => {
      if (this.#asked.value) void this.load();
      else this.playing.value = false;
    });
    const follow = effect(() => {
      const motion = this.shown.value;
      this.#at = this.phase.value = view.phase.value ?? 0;
      if (motion) this.#move(motion);
    });
    const begin = effect(() => {
      this.#last = 0;
      void this.playing.value;
    });
    this.#leave = [load, follow, begin];
  }

  /** Shows the first frame; plays unless the user prefers reduced motion. */
  start(): void {
    this.#view.phase.value ??= 0;
    this.playing.value = !stillness.peek();
  }

  toggle(): void {
    this.#view.phase.value = this.#at;
    this.playing.value = !this.playing.peek();
  }

  /** Stops at a fraction of the period. */
  seek(phase: number): void {
    this.playing.value = false;
    this.#view.phase.value = phase;
  }

  /** Shows the tube at rest. */
  leave(): void {
    this.#view.phase.value = undefined;
  }

  /** Loads the animation unless it is loaded or loading. */
  async load(): Promise<void> {
    const { file } = this;
    if (!file || this.motion.peek() || this.loading.peek() !== undefined) return;
    const { signal } = this.#abort;
    batch(() => {
      this.fault.value = undefined;
      this.loading.value = 0;
    });
    try {
      const onProgress = (received: number) => {
        if (!signal.aborted) this.loading.value = received;
      };
      const bytes = await ask((service) => service.bytes(this.#model.id, file.name, { onProgress, signal }));
      const { begin, course } = this.#tube;
      const motion = await readMotion(bytes, course ? 0 : begin, course);
      if (!signal.aborted) this.motion.value = motion;
    } catch (error) {
      if (!signal.aborted) this.fault.value = explain(error);
    } finally {
      this.loading.value = undefined;
    }
  }

  /** Advances to the time of a frame, outside effects; returns true while the animation plays. */
  advance = (now: number): boolean => {
    const motion = this.shown.value;
    if (!this.playing.value || !motion) return false;
    if (this.#last > 0) this.#at = (this.#at + Math.min(TOLD, now - this.#last) / (1000 * motion.period)) % 1;
    this.#last = now;
    if (now - this.#told > TOLD) {
      this.#told = now;
      this.#view.phase.value = this.#at;
    } else {
      this.#move(motion);
    }
    return true;
  };

  dispose(): void {
    this.#abort.abort();
    for (const leave of this.#leave) leave();
  }

  #move(motion: Motion): void {
    motion.moveTo(this.#at);
    this.onMove?.();
  }
}

/** Text for the shown frame and the time in seconds. */
export function timeInWords(phase: number, { frames, period }: Pick<Motion, "frames" | "period">): string {
  // The last frame is one step before the end of the period.
  const frame = Math.floor(phase * frames + 1e-6) % frames;
  return `Frame ${frame + 1} of ${frames} · ${(phase * period).toFixed(2)} s`;
}
