// Loads what is wanted last, and not what is passed on the way there.
import { batch, effect, signal } from "@preact/signals";

/** What came of a request. */
export type Outcome<T> = { key: string; value: T; fault?: undefined } | { key: string; value?: undefined; fault: unknown };

type Load<T> = (signal: AbortSignal) => Promise<T>;

export class Latest<T> {
  /** The last one that came: it stays until that of another key is there. */
  readonly outcome = signal<Outcome<T> | undefined>(undefined);
  /** Key that is being loaded, or will be. */
  readonly awaited = signal<string | undefined>(undefined);
  readonly #pause: number;
  readonly #kept: number;
  readonly #drop: (value: T) => void;
  /** What has come, the least recently used first. */
  readonly #known = new Map<string, T>();
  #wanted: { key: string; load: Load<T> } | undefined;
  #abort = new AbortController();

  /**
   * @param pause Milliseconds for which a key must be wanted before it is loaded.
   * @param kept How many values are kept.
   * @param drop Called with each value that is not kept any longer.
   */
  constructor(pause: number, kept: number, drop: (value: T) => void = () => {}) {
    this.#pause = pause;
    this.#kept = kept;
    this.#drop = drop;
  }

  /** Asks for the value of a key, which `load` gives. What was wanted before is aborted. */
  want(key: string, load: Load<T>): void {
    if (this.#wanted?.key === key) return;
    this.#wanted = { key, load };
    this.#start(this.#pause);
  }

  /** Loads once more what has failed. */
  again(): void {
    if (this.#wanted && this.outcome.peek()?.key === this.#wanted.key && this.outcome.peek()?.fault !== undefined) this.#start(0);
  }

  /** Resolves when nothing is awaited. */
  settled(): Promise<void> {
    return new Promise((resolve) => {
      const leave = effect(() => {
        if (this.awaited.value === undefined) queueMicrotask(() => (leave(), resolve()));
      });
    });
  }

  /** Asks for nothing more. */
  stop(): void {
    this.#abort.abort();
    this.#wanted = undefined;
    this.awaited.value = undefined;
  }

  /** Drops all values. */
  dispose(): void {
    this.stop();
    this.outcome.value = undefined;
    for (const value of this.#known.values()) this.#drop(value);
    this.#known.clear();
  }

  #start(pause: number): void {
    this.#abort.abort();
    this.#abort = new AbortController();
    const { signal } = this.#abort;
    const { key, load } = this.#wanted!;
    const value = this.#known.get(key);
    if (value !== undefined) {
      this.#settle({ key, value });
      return;
    }
    this.awaited.value = key;
    const timer = setTimeout(async () => {
      let outcome: Outcome<T>;
      try {
        outcome = { key, value: await load(signal) };
      } catch (fault) {
        outcome = { key, fault: fault ?? new Error("unknown") };
      }
      if (!signal.aborted) this.#settle(outcome);
      else if (outcome.value !== undefined) this.#drop(outcome.value);
    }, pause);
    signal.addEventListener("abort", () => clearTimeout(timer));
  }

  #settle(outcome: Outcome<T>): void {
    if (outcome.value !== undefined) {
      this.#known.delete(outcome.key);
      this.#known.set(outcome.key, outcome.value);
    }
    batch(() => {
      this.outcome.value = outcome;
      this.awaited.value = undefined;
    });
    for (const [key, value] of this.#known) {
      if (this.#known.size <= this.#kept) break;
      this.#known.delete(key);
      this.#drop(value);
    }
  }
}
