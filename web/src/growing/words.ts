// The activity of a model in words.
import type { ModelRequest, ModelState, Progress, Worker, WorkerList } from "oviduct-client";
import { duration } from "../ui/format.ts";

type Queue = ModelState["queue"];

/** The stages of growth in their order. */
export const STAGES: readonly { stage: Progress["stage"]; name: string; meaning: string }[] = [
  { stage: "simulate", name: "Growth", meaning: "The folds grow, section by section, from the isthmus to the ampulla." },
  { stage: "mesh", name: "Surface", meaning: "The sections are joined to one closed surface." },
  { stage: "certify", name: "Certificate", meaning: "The surface is tested: closed, oriented, free of intersections." },
  { stage: "measure", name: "Morphometry", meaning: "The sections are measured and compared with published anatomy." },
  { stage: "export", name: "Files", meaning: "The files are written." },
  { stage: "store", name: "Storage", meaning: "The files are stored." },
];

/** Reasons why no worker starts a queued model. */
const REASONS: Record<NonNullable<Queue["reason"]>, string> = {
  "no-worker": "no running worker can grow it",
  paused: "the workers are paused",
  storage: "the workers cannot store files",
  "equal-model": "an equal model is grown first",
};

/** `2 models are ahead; the workers are paused`. */
export function placeInQueue(queue: Queue): string {
  const reason = queue.reason && REASONS[queue.reason];
  return reason ? `${place(queue)}; ${reason}` : place(queue);
}

function place({ position, position_is_exact: exact }: Queue): string {
  if (position === null || position === undefined) return "Waiting for a worker";
  if (position === 0) return "Next in the queue";
  if (exact === false) return `At least ${position} models are ahead`;
  return position === 1 ? "1 model is ahead" : `${position} models are ahead`;
}

export function percent(fraction: number): string {
  // 100 % is reserved for complete models.
  return `${Math.min(99, Math.floor(fraction * 100))} %`;
}

/** `Growth, 45 %, 12 s left`. */
export function growth(progress: Progress | null | undefined): string {
  if (!progress) return "Starting";
  const stage = STAGES.find(({ stage }) => stage === progress.stage)?.name ?? progress.stage;
  const left = progress.eta_seconds;
  return [stage, percent(progress.fraction), typeof left === "number" && `${duration(Math.max(1, Math.round(left)))} left`]
    .filter(Boolean)
    .join(", ");
}

export function hasEnded({ status }: Pick<ModelState, "status">): boolean {
  return status === "succeeded" || status === "failed" || status === "cancelled";
}

/** The workers that start models, unless a condition prevents them. */
export function activeWorkers({ pause, workers }: WorkerList): Worker[] {
  return pause ? [] : workers.filter(({ state }) => state === "active");
}

/** The workers that start models. */
function claimingWorkers(list: WorkerList): Worker[] {
  return activeWorkers(list).filter(({ condition }) => !condition);
}

/**
 * Reason why no worker would start a model, and a remedy; undefined if a worker would, or if
 * unknown.
 */
export function standstill(list: WorkerList | undefined, backend: ModelRequest["backend"] = "auto"): { title: string; detail: string } | undefined {
  if (!list) return undefined;
  if (list.pause) {
    return { title: "All workers are paused", detail: "Models wait until an administrator resumes them: “oviduct workers resume”." };
  }
  const active = activeWorkers(list);
  if (active.length === 0) {
    return list.workers.length === 0
      ? { title: "No worker is running", detail: "Models wait until a worker is started: by “oviduct worker”, or with the service by “--cpu-workers 1”." }
      : { title: "No worker takes new models", detail: "Those that run are paused or are being shut down. Models wait until one is resumed or started." };
  }
  const claiming = claimingWorkers(list);
  if (claiming.length === 0) {
    return { title: "The workers cannot store files", detail: "Models wait until an administrator frees space or restores access to the artifact store." };
  }
  const fits = backend === "auto" || claiming.some((worker) => (worker.backend === "gpu") === (backend === "gpu"));
  if (fits) return undefined;
  return backend === "gpu"
    ? { title: "No GPU worker is active", detail: "Choose “Automatic”, or start a worker on a machine with a GPU." }
    : { title: "No CPU worker is active", detail: "Choose “Automatic”, or start a worker with “--cpu-workers 1”." };
}
