// Loads the latest requested value and skips values that were requested only briefly.
import { batch, effect, signal } from "@preact/signals";

/** Result of a request. */
export type Outcome<T> = { key: string; value: T; fault?: undefined } | { key: string; value?: undefined; fault: unknown };

type Load<T> = (signal: AbortSignal) => Promise<T>;

export class Latest<T> {
  /** The last result; it stays until the result for another key arrives. */
  readonly outcome = signal<Outcome<T> | undefined>(undefined);
  /** Key that is being loaded or will be. */
  readonly awaited = signal<string | undefined>(undefined);
  readonly #pause: number;
  readonly #kept: number;
  readonly #drop: (value: T) => void;
  /** Loaded values, least recently used first. */
  readonly #known = new Map<string, T>();
  #wanted: { key: string; load: Load<T> } | undefined;
  #abort = new AbortController();

  /**
   * @param pause Milliseconds for which a key must stay requested before it is loaded.
   * @param kept Maximum number of kept values.
   * @param drop Called with each dropped value.
   */
  constructor(pause: number, kept: number, drop: (value: T) => void = () => {}) {
    this.#pause = pause;
    this.#kept = kept;
    this.#drop = drop;
  }

  /**
   * Requests the value of a key, which `load` returns. Aborts the previous request.
   *
   * The first request starts at once.
   */
  want(key: string, load: Load<T>): void {
    if (this.#wanted?.key === key) return;
    const pause = this.#wanted ? this.#pause : 0;
    this.#wanted = { key, load };
    this.#start(pause);
  }

  /** Repeats the failed request. */
  again(): void {
    if (this.#wanted && this.outcome.peek()?.key === this.#wanted.key && this.outcome.peek()?.fault !== undefined) this.#start(0);
  }

  /** Resolves when no request is pending. */
  settled(): Promise<void> {
    return new Promise((resolve) => {
      const leave = effect(() => {
        if (this.awaited.value === undefined) queueMicrotask(() => (leave(), resolve()));
      });
    });
  }

  /** Stops all requests. */
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
