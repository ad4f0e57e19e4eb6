import { useEffect, useRef, useState } from "preact/hooks";
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
  const earliest = useRef(0);
  useEffect(() => {
    const abort = new AbortController();
    const run = async () => {
      const begun = Date.now();
      try {
        const value = await read(abort.signal);
        if (!abort.signal.aborted) setResult({ key, value });
      } catch (fault) {
        // What was read before stays.
        if (!abort.signal.aborted) setResult((before) => (before.key === key ? { ...before, fault } : { key, fault }));
      }
      earliest.current = Date.now() + Math.max(PAUSE, RELIEF * (Date.now() - begun));
    };
    const timer = setTimeout(run, result.key === key && result.value !== undefined ? earliest.current - Date.now() : 0);
    return () => {
      clearTimeout(timer);
      abort.abort();
    };
  }, [key, changes.value, reconnections.value, retries]);
  const present = result.key === key ? result : undefined;
  return { value: present?.value, fault: present?.fault, again: () => setRetries(retries + 1) };
}
