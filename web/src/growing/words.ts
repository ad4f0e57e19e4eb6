// What a model is doing, in words.
import type { ModelState, Progress } from "oviduct-client";
import { duration } from "../ui/format.ts";

/** The stages of growth in their order. */
export const STAGES: readonly { stage: Progress["stage"]; name: string; meaning: string }[] = [
  { stage: "simulate", name: "Growth", meaning: "The folds grow, section by section, from the isthmus to the ampulla." },
  { stage: "mesh", name: "Surface", meaning: "The sections are joined to one closed surface." },
  { stage: "certify", name: "Certificate", meaning: "The surface is tested: closed, oriented, free of intersections." },
  { stage: "export", name: "Files", meaning: "The files are written." },
  { stage: "store", name: "Storage", meaning: "The files are stored." },
];

/** The service counts the models ahead up to this number. */
const COUNTED = 1000;

export function placeInQueue(position: number | null | undefined): string {
  if (position === null || position === undefined) return "Waiting for a worker";
  if (position === 0) return "Next in the queue";
  if (position >= COUNTED) return `More than ${COUNTED} models are ahead`;
  return position === 1 ? "1 model is ahead" : `${position} models are ahead`;
}

export function percent(fraction: number): string {
  // 100 % is for what is complete.
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
