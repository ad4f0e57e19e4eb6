// The contraction of a model: loads its animation when it is asked for, plays it and moves to places in it.
import { batch, computed, effect, signal } from "@preact/signals";
import type { Model, ModelFile } from "oviduct-client";
import { ask, explain } from "../service.ts";
import { stillness } from "../ui/theme.ts";
import type { Tube } from "./framing.ts";
import type { View } from "./view.ts";
import { readMotion, type Motion } from "./viewer/motion.ts";

/** Milliseconds between the times that are told to controls and link while playing. */
const TOLD = 100;

export class Contraction {
  /** The animation, if the model has one. */
  readonly file: ModelFile | undefined;
  readonly motion = signal<Motion | undefined>(undefined);
  /** Bytes of the animation that have come while it is loaded. */
  readonly loading = signal<number | undefined>(undefined);
  /** Why it did not come. */
  readonly fault = signal<string | undefined>(undefined);
  readonly playing = signal(false);
  /** The motion while it is shown in place of the tube at rest. */
  readonly shown = computed(() => (this.#asked.value ? this.motion.value : undefined));
  /** Time for the controls, part of the period. */
  readonly phase = signal(0);
  /** Called when the motion has moved. */
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

  /** Shows the first frame, and plays unless the user asks for less motion. */
  start(): void {
    this.#view.phase.value ??= 0;
    this.playing.value = !stillness.peek();
  }

  toggle(): void {
    this.#view.phase.value = this.#at;
    this.playing.value = !this.playing.peek();
  }

  /** Stops at a part of the period. */
  seek(phase: number): void {
    this.playing.value = false;
    this.#view.phase.value = phase;
  }

  /** Shows the tube at rest. */
  leave(): void {
    this.#view.phase.value = undefined;
  }

  /** Loads the animation unless it is there, or is being loaded. */
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

  /** Moves on to the time of a frame of the picture, outside effects; whether it goes on. */
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

/** The frame that is shown, or was last, and the time in seconds. */
export function timeInWords(phase: number, { frames, period }: Pick<Motion, "frames" | "period">): string {
  // The last frame is one step before the end of the period.
  const frame = Math.floor(phase * frames + 1e-6) % frames;
  return `Frame ${frame + 1} of ${frames} · ${(phase * period).toFixed(2)} s`;
}
