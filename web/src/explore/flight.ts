// Moving through the lumen: play, pause, speed and keys.
import { effect, signal } from "@preact/signals";
import { stillness } from "../ui/theme.ts";
import type { View } from "./view.ts";

/** Millimetres a second. */
export const SPEEDS = [0.5, 1, 2, 4] as const;
/** Millimetres that a key moves. */
const STEP = 0.1;
const BIG_STEP = 1;
const CONTROLS_MS = 100;

export class Flight {
  readonly playing = signal(false);
  readonly speed = signal<number>(1);
  /** Position for the controls: that of the view, but only ten times a second while playing. */
  readonly shown = signal(0);
  readonly #view: View;
  /** Length of the tube, millimetres. */
  readonly #length: number;
  #pending = 0;
  #last = 0;
  readonly #leave: (() => void)[];

  constructor(view: View, length: number) {
    this.#view = view;
    this.#length = length;
    const play = effect(() => {
      cancelAnimationFrame(this.#pending);
      if (this.playing.value && view.flight.value === undefined) this.playing.value = false;
      if (!this.playing.value) return;
      this.#last = 0;
      this.#pending = requestAnimationFrame(this.#advance);
    });
    let updated = 0;
    const show = effect(() => {
      const at = view.flight.value ?? 0;
      const now = performance.now();
      if (this.playing.value && now - updated < CONTROLS_MS) return;
      updated = now;
      this.shown.value = at;
    });
    this.#leave = [play, show];
  }

  /** Enters the lumen at the isthmus end, or where the flight was; moves unless the user asks for less motion. */
  start(): void {
    this.#view.flight.value ??= 0;
    this.playing.value = !stillness.peek();
  }

  leave(): void {
    this.#view.flight.value = undefined;
  }

  toggle(): void {
    if (this.#view.flight.peek() === 1) this.#view.flight.value = 0;
    this.playing.value = !this.playing.peek();
  }

  move(millimetres: number): void {
    const at = this.#view.flight.peek();
    if (at !== undefined) this.#view.flight.value = Math.max(0, Math.min(1, at + millimetres / this.#length));
  }

  /** Whether the key was used. */
  key = (key: string): boolean => {
    const step = { ArrowUp: STEP, ArrowRight: STEP, ArrowDown: -STEP, ArrowLeft: -STEP, PageUp: BIG_STEP, PageDown: -BIG_STEP }[key];
    if (step !== undefined) this.move(step);
    else if (key === " ") this.toggle();
    else if (key === "Escape") this.leave();
    else if (key === "Home") this.#view.flight.value = 0;
    else if (key === "End") this.#view.flight.value = 1;
    else return false;
    return true;
  };

  dispose(): void {
    for (const leave of this.#leave) leave();
    cancelAnimationFrame(this.#pending);
  }

  readonly #advance = (now: number): void => {
    this.#pending = requestAnimationFrame(this.#advance);
    const seconds = this.#last === 0 ? 0 : Math.min(0.1, (now - this.#last) / 1000);
    this.#last = now;
    this.move(seconds * this.speed.peek());
    if (this.#view.flight.peek() === 1) this.playing.value = false;
  };
}
