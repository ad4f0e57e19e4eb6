// The workers of the service, and a notice if none of them starts what waits.
import { effect, signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import type { WorkerList } from "oviduct-client";
import { ask, session } from "../service.ts";
import { reconnections } from "../stream.ts";
import { Notice } from "../ui/widgets.tsx";
import { standstill } from "./words.ts";

/** Milliseconds between two looks at the workers. */
const INTERVAL = 10_000;

/** As they were read last. */
export const workers = signal<WorkerList | undefined>(undefined);

/** Reads the list of workers now and then, until the result is called. */
export function watchWorkers(): () => void {
  const abort = new AbortController();
  const read = async () => {
    if (document.hidden) return;
    try {
      workers.value = await ask((service) => service.workers({ signal: abort.signal }));
    } catch {
      // The frame says that the service does not answer; what was known stays.
    }
  };
  const timer = setInterval(read, INTERVAL);
  const stop = effect(() => {
    void [reconnections.value, session.value];
    void read();
  });
  return () => {
    clearInterval(timer);
    stop();
    abort.abort();
  };
}

/** Shown beside models that wait: why none of them starts, if that is so. */
export function WorkersNotice() {
  useEffect(watchWorkers, []);
  const trouble = standstill(workers.value);
  return trouble ? <Notice title={trouble.title}><p>{trouble.detail}</p></Notice> : null;
}
