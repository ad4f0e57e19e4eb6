// Flight through the lumen: play, pause, speed and keys.
import { effect, signal, type ReadonlySignal } from "@preact/signals";
import { stillness } from "../ui/theme.ts";
import type { View } from "./view.ts";

/** Millimetres per second. */
export const SPEEDS = [0.5, 1, 2, 4] as const;
/** Millimetres per key press. */
const STEP = 0.1;
const BIG_STEP = 1;
/** Milliseconds between updates of the controls and the link during the flight. */
const TOLD = 100;
/** Milliseconds between updates of the cross section and the charts. */
const FOLLOWED = 250;

export class Flight {
  readonly playing = signal(false);
  readonly speed = signal<number>(1);
  /** Position for the controls. */
  readonly shown = signal(0);
  readonly #view: View;
  /** Length of the tube, millimetres. */
  readonly #length: number;
  readonly #ready: ReadonlySignal<boolean>;
  readonly #onward: (place: number, millimetres: number) => number;
  #last = 0;
  #told = 0;
  /** Time of the last update of the cross section; undefined outside the flight. */
  #followed: number | undefined;
  readonly #leave: (() => void)[];

  /**
   * The flight does not move until it is `ready`. `onward` is the place after a piece of the way,
   * both in millimetres.
   */
  constructor(
    view: View,
    length: number,
    ready: ReadonlySignal<boolean>,
    onward: (place: number, millimetres: number) => number,
  ) {
    this.#view = view;
    this.#length = length;
    this.#ready = ready;
    this.#onward = onward;
    const follow = effect(() => {
      const at = view.flight.value;
      this.#follow(at);
      this.shown.value = view.flown = at ?? 0;
    });
    const play = effect(() => {
      this.#last = 0;
      void ready.value;
      if (this.playing.value && !view.flying.value) this.playing.value = false;
    });
    this.#leave = [follow, play];
  }

  /**
   * Enters the lumen at the last position, or at the isthmus end.
   *
   * Starts to move unless the user prefers reduced motion.
   */
  start(): void {
    this.#view.flight.value ??= 0;
    this.playing.value = !stillness.peek();
  }

  leave(): void {
    this.#view.flight.value = undefined;
  }

  toggle(): void {
    const { flight, flown } = this.#view;
    flight.value = flown === 1 ? 0 : flown;
    this.playing.value = !this.playing.peek();
  }

  move(millimetres: number): void {
    const { flight, flown } = this.#view;
    if (flight.peek() !== undefined) flight.value = Math.max(0, Math.min(1, flown + millimetres / this.#length));
  }

  /** Handles a key; returns true if the key has a function. */
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
  }

  /** Moves the cross section with the flight; at the end, to the place where it was left. */
  #follow(at: number | undefined): void {
    const view = this.#view;
    if (at === undefined) {
      if (this.#followed !== undefined) view.section.value = view.flown;
      this.#followed = undefined;
    } else if (!this.playing.value || performance.now() - (this.#followed ?? -Infinity) >= FOLLOWED) {
      this.#followed = performance.now();
      view.section.value = at;
    }
  }

  /** Advances to the time of a frame, outside effects; returns true while the flight continues. */
  advance = (now: number): boolean => {
    if (!this.playing.value || !this.#ready.value) return false;
    const view = this.#view;
    if (this.#last > 0) {
      const millimetres = (Math.min(100, now - this.#last) * this.speed.value) / 1000;
      view.flown = Math.min(1, this.#onward(view.flown * this.#length, millimetres) / this.#length);
    }
    this.#last = now;
    const ended = view.flown === 1;
    if (ended || now - this.#told > TOLD) {
      this.#told = now;
      view.flight.value = view.flown;
    }
    if (ended) this.playing.value = false;
    return !ended;
  };
}
