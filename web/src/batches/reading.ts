import { effect } from "@preact/signals";
import { useEffect, useState } from "preact/hooks";
import { changes } from "../models.ts";
import { reconnections } from "../stream.ts";

/**
 * Minimum time between two readings in milliseconds, and as a multiple of the last reading's
 * duration.
 */
const [PAUSE, RELIEF] = [1500, 10];

export interface Reading<T> {
  value: T | undefined;
  /** Error of the last reading. */
  fault: unknown;
  again: () => void;
}

/** Result of a call, which is repeated after changes of models. `key` identifies the call. */
export function useReading<T>(key: string, read: (signal: AbortSignal) => Promise<T>): Reading<T> {
  const [result, setResult] = useState<{ key: string; value?: T; fault?: unknown }>({ key });
  const [retries, setRetries] = useState(0);
  useEffect(() => {
    const abort = new AbortController();
    let timer: ReturnType<typeof setTimeout> | undefined;
    let [reading, outdated, earliest] = [false, false, 0];
    // Changes do not abort a reading. Otherwise no reading would complete while many models end.
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
      // After a failed reading, the previous result stays.
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
