// Loads the way of the flight, and says what the flight waits for.
import { signal } from "@preact/signals";
import { OviductError } from "oviduct-client";
import { ask, explain } from "../service.ts";
import type { Tube } from "./framing.ts";
import { Way } from "./way.ts";

/** Reason why a flight cannot begin. */
export interface Obstacle {
  words: string;
  /** `waiting` ends by itself, `failed` may end after a retry, `none` never ends. */
  state: "waiting" | "failed" | "none";
}

/** Problems for which another request has the same result, and their meaning. */
const REASONS = {
  "file-not-found": "The model has no surface in which a way could be found.",
  "surface-too-large": "The surface is too large for the service to find a way.",
} as const;

/** The obstacle that an error of the request for a way means. */
export function obstacleOf(error: unknown): Obstacle {
  if (error instanceof OviductError) {
    const slug = (Object.keys(REASONS) as (keyof typeof REASONS)[]).find((slug) => error.is(slug));
    if (slug) return { words: REASONS[slug], state: "none" };
    if (error.is("way-not-found")) return { words: error.detail, state: "none" };
  }
  return { words: `The way could not be loaded. ${explain(error)}`, state: "failed" };
}

/** Obstacle of a way that is being looked for. */
const LOOKING: Obstacle = { words: "Looking for the way through the lumen …", state: "waiting" };

/** The way through the lumen of one model. */
export class Passage {
  readonly way = signal<Way | undefined>(undefined);
  /** Reason why there is no way yet. */
  readonly obstacle = signal<Obstacle | undefined>(LOOKING);
  readonly #id: string;
  readonly #tube: Tube;
  readonly #abort = new AbortController();
  #loading = false;

  constructor(id: string, tube: Tube) {
    this.#id = id;
    this.#tube = tube;
  }

  /** Loads the way, unless it is loaded or loading, or there is none. */
  async load(): Promise<void> {
    if (this.#loading || this.way.peek() || this.obstacle.peek()?.state === "none") return;
    const { signal } = this.#abort;
    this.#loading = true;
    this.obstacle.value = LOOKING;
    try {
      const answer = await ask((service) => service.way(this.#id, { signal }));
      if (signal.aborted) return;
      this.way.value = new Way(answer, this.#tube);
      this.obstacle.value = undefined;
    } catch (error) {
      if (!signal.aborted) this.obstacle.value = obstacleOf(error);
    } finally {
      this.#loading = false;
    }
  }

  /** The place after a piece of the way, millimetres; see {@link Way.onward}. */
  readonly onward = (place: number, millimetres: number): number =>
    this.way.peek()?.onward(place, millimetres) ?? place + millimetres;

  /** Repeats a request that failed. */
  async again(): Promise<void> {
    if (this.obstacle.peek()?.state === "failed") await this.load();
  }

  dispose(): void {
    this.#abort.abort();
  }
}
