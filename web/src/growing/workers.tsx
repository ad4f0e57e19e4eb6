// The workers of the service, and a notice if none of them starts queued models.
import { effect, signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import type { WorkerList } from "oviduct-client";
import { ask, session } from "../service.ts";
import { reconnections } from "../stream.ts";
import { Notice } from "../ui/widgets.tsx";
import { standstill } from "./words.ts";

/** Milliseconds between two requests for the workers. */
const INTERVAL = 10_000;

/** The last received list of workers. */
export const workers = signal<WorkerList | undefined>(undefined);

/** Requests the list of workers periodically, until the returned function is called. */
export function watchWorkers(): () => void {
  const abort = new AbortController();
  const read = async () => {
    if (document.hidden) return;
    try {
      workers.value = await ask((service) => service.workers({ signal: abort.signal }));
    } catch {
      // The frame of the page reports the lost connection; the last list stays.
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

/** Shown next to queued models: the reason why no worker starts them, if that is the case. */
export function WorkersNotice() {
  useEffect(watchWorkers, []);
  const trouble = standstill(workers.value);
  return trouble ? <Notice title={trouble.title}><p>{trouble.detail}</p></Notice> : null;
}
