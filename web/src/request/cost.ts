// The predicted cost of a request in words.
import type { BatchValidation, Validation, WorkerList } from "oviduct-client";
import { activeWorkers } from "../growing/words.ts";
import { bytes, duration, short } from "../ui/format.ts";
import type { Opinion } from "./check.ts";
import type { Backend } from "./form.ts";

const NAMES: Record<string, string> = { gpu: "the GPU", cpu: "the CPU", "cpu-single": "one core" };

export interface Cost {
  /** Number of models and duration. */
  headline: string;
  /** All other information in one line. */
  brief: string;
  details: [term: string, value: string][];
}

export function costOf(opinion: Opinion | undefined, backend: Backend, workers: WorkerList | undefined): Cost | undefined {
  if (opinion?.kind === "model") return modelCost(opinion.validation, backend, workers);
  if (opinion?.kind === "study") return studyCost(opinion.validation, backend, workers);
  return undefined;
}

function modelCost({ cost }: Validation, backend: Backend, workers: WorkerList | undefined): Cost {
  const seconds = Object.fromEntries(Object.entries(cost.seconds).map(([name, estimate]) => [name, estimate.seconds]));
  const { sections, report, ...outputs } = cost.bytes;
  const models = Object.entries(outputs).map(([name, size]) => `${bytes(size)} as ${name}`);
  const all = Object.values(cost.bytes).reduce((sum, size) => sum + size, 0);
  const [headline = "No prediction of the time", ...others] = times(seconds, backend, workers);
  return {
    headline,
    brief: `${count(cost.triangles)} triangles, ${bytes(all)} of files, ${bytes(cost.memory_bytes)} of memory`,
    details: [
      ...others.map((text): [string, string] => ["Or", text]),
      ["Surface", `${count(cost.triangles)} triangles`],
      ["Sections", short(cost.sections)],
      ["Particles at the end", short(cost.particles_end)],
      ...(models.length > 0 ? [["Model", models.join(", ")] as [string, string]] : []),
      ["All files", bytes(all)],
      ["Memory to grow it", bytes(cost.memory_bytes)],
    ],
  };
}

function studyCost({ cost, models, points, seeds }: BatchValidation, backend: Backend, workers: WorkerList | undefined): Cost {
  const each = models / points.length;
  const triangles = points.map((point) => point.cost.triangles);
  const [least, most] = [Math.min(...triangles), Math.max(...triangles)];
  const [time = "No prediction of the time", ...others] = times(cost.seconds, backend, workers);
  const surface = `${least === most ? count(most) : `${count(least)} to ${count(most)}`} triangles`;
  return {
    brief: `${surface} each, ${bytes(cost.bytes)} of files, ${bytes(cost.memory_bytes)} of memory`,
    headline: `${plural(models, "model")}: ${time}${models === 1 ? "" : " in all"}`,
    details: [
      ...others.map((text): [string, string] => ["Or", text]),
      ["Models", `${plural(points.length, "point")} × ${plural(each, "seed")}${seeds ? "" : ", drawn"}`],
      ["Surface of each", surface],
      ["All files", bytes(cost.bytes)],
      ["Memory of the largest", bytes(cost.memory_bytes)],
    ],
  };
}

/** Times on the backends that can run the request, the most likely one first. */
function times(seconds: Record<string, number>, backend: Backend, workers: WorkerList | undefined): string[] {
  const present = new Set(workers ? activeWorkers(workers).map((worker) => worker.backend) : []);
  const candidates = backend === "auto" ? (["gpu", "cpu", "cpu-single"] as const).filter((name) => present.has(name)) : [backend];
  const shown = candidates.length > 0 ? candidates : (["cpu"] as const);
  return shown.flatMap((name) => (seconds[name] === undefined ? [] : [`about ${duration(seconds[name])} on ${NAMES[name]}`]));
}

function plural(number: number, noun: string): string {
  return `${short(number)} ${noun}${number === 1 ? "" : "s"}`;
}

function count(number: number): string {
  return number >= 1e6 ? `${short(number / 1e6)} million` : short(number);
}
