// Says so if nothing will grow what waits.
import { signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import type { WorkerList } from "oviduct-client";
import { ask } from "../service.ts";
import { Notice } from "../ui/widgets.tsx";

const workers = signal<WorkerList | undefined>(undefined);
/** Milliseconds between two looks at the workers. */
const INTERVAL = 10_000;

/** Shown beside models that wait: why none of them starts, if that is so. */
export function WorkersNotice() {
  useEffect(() => {
    const look = () => {
      // If the service cannot be reached, the frame of the page says so.
      if (!document.hidden) ask((service) => service.workers()).then((list) => (workers.value = list), () => {});
    };
    look();
    const timer = setInterval(look, INTERVAL);
    return () => clearInterval(timer);
  }, []);
  const trouble = workers.value && standstill(workers.value);
  return trouble ? <Notice title={trouble.title}><p>{trouble.detail}</p></Notice> : null;
}

export function standstill({ pause, workers }: WorkerList): { title: string; detail: string } | undefined {
  if (pause) {
    return { title: "The queue is paused", detail: "Whoever runs the service has paused all workers. Models wait, and start when the pause ends." };
  }
  if (workers.length === 0) {
    return { title: "No worker is running", detail: "Models wait until a worker is started. “oviduct serve” starts its own, unless --cpu-workers is 0; “oviduct worker” starts one on another machine." };
  }
  if (!workers.some(({ state }) => state === "active")) {
    return { title: "All workers are paused or shut down", detail: "Models wait until a worker takes up work again." };
  }
  return undefined;
}
