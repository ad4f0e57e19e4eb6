import { effect } from "@preact/signals";
import { useEffect, useState } from "preact/hooks";
import { changes } from "../models.ts";
import { reconnections } from "../stream.ts";

/** Milliseconds between two readings, at least; and how many times the time that the last one took. */
const [PAUSE, RELIEF] = [1500, 10];

export interface Reading<T> {
  value: T | undefined;
  /** Why the last reading failed. */
  fault: unknown;
  again: () => void;
}

/** What a call of the service answers, read again after changes of models. `key` says what is asked for. */
export function useReading<T>(key: string, read: (signal: AbortSignal) => Promise<T>): Reading<T> {
  const [result, setResult] = useState<{ key: string; value?: T; fault?: unknown }>({ key });
  const [retries, setRetries] = useState(0);
  useEffect(() => {
    const abort = new AbortController();
    let timer: ReturnType<typeof setTimeout> | undefined;
    let [reading, outdated, earliest] = [false, false, 0];
    // A reading that has begun is not cut off by changes, or there would be none while many models end.
    const plan = () => {
      if (reading) outdated = true;
      else timer ??= setTimeout(run, Math.max(0, earliest - Date.now()));
    };
    const run = async () => {
      timer = undefined;
      [reading, outdated] = [true, false];
      const begun = Date.now();
      const result = await read(abort.signal).then((value) => ({ key, value }), (fault: unknown) => ({ fault }));
      if (abort.signal.aborted) return;
      // What was read before stays if it cannot be read again.
      setResult((before) => ({ ...(before.key === key && before), key, fault: undefined, ...result }));
      reading = false;
      earliest = Date.now() + Math.max(PAUSE, RELIEF * (Date.now() - begun));
      if (outdated) plan();
    };
    const stop = effect(() => {
      void changes.value;
      void reconnections.value;
      plan();
    });
    return () => {
      stop();
      clearTimeout(timer);
      abort.abort();
    };
  }, [key, retries]);
  const present = result.key === key ? result : undefined;
  return { value: present?.value, fault: present?.fault, again: () => setRetries(retries + 1) };
}
