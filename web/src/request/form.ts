// The state of the form, and the request that it describes.
import type { BatchRequest, Fault, ModelRequest } from "oviduct-client";
import type { Parameter } from "./parameters.ts";
import { specPatch, type Changes, type Json } from "./patch.ts";
import { isSchedule, type Value } from "./schedule.ts";
import { readList, readNumber, readPoints, readSeeds } from "./text.ts";

export type Backend = NonNullable<ModelRequest["backend"]>;
export type Output = NonNullable<ModelRequest["outputs"]>[number];
export type Body = NonNullable<ModelRequest["bodies"]>[number];
export type Units = NonNullable<ModelRequest["units"]>;

export const BACKENDS: Record<Backend, string> = {
  auto: "Automatic (GPU or CPU)",
  gpu: "GPU",
  cpu: "CPU",
  "cpu-single": "CPU, one thread",
};
export const OUTPUTS: Record<Output, string> = {
  glb: "glTF, the certified surface (.glb)",
  lod: "Three levels of detail, for this page and other viewers",
  gltf: "glTF as text (.gltf, .bin)",
  obj: "Wavefront (.obj)",
  stl: "STL, binary (.stl)",
  "stl-ascii": "STL as text, one solid a patch (.ascii.stl)",
  ply: "PLY (.ply)",
  vtp: "VTK, ParaView (.vtp)",
  "3mf": "3MF, for 3D printers (.3mf)",
  centreline: "Centre line with radii (.vtp, .csv)",
  labels: "Tissue of every voxel (.ome.tif, .nii.gz)",
};
export const BODIES: Record<Body, string> = {
  tissue: "Tissue (model.…)",
  lumen: "Lumen, with inlet and outlet (lumen.…)",
  regions: "Both, their wall once (regions.…)",
};
export const UNITS: Record<Units | "habit", string> = {
  habit: "The habit of each format",
  m: "Metres",
  mm: "Millimetres",
  um: "Micrometres",
};
/** Outputs of a request without `outputs`. */
const DEFAULT_OUTPUTS: readonly Output[] = ["glb", "lod"];
const DEFAULT_BODIES: readonly Body[] = ["tissue"];

/** A parameter that a study varies. Numbers are stored as typed. */
export interface Varied {
  pointer: string;
  values: "range" | "list";
  from: string;
  to: string;
  count: string;
  list: string;
}

export interface Form {
  /** Undefined for the default preset. */
  preset: string | undefined;
  seed: string;
  changes: Changes;
  labels: readonly { name: string; value: string }[];
  outputs: readonly Output[];
  bodies: readonly Body[];
  units: Units | "habit";
  backend: Backend;
  priority: string;
  reuse: boolean;
  purpose: "model" | "study";
  /** Seeds of a study: the service draws one or several, or the user gives them. */
  seeds: "one" | "drawn" | "given";
  seedCount: string;
  seedList: string;
  design: "grid" | "lhs";
  samples: string;
  varied: readonly Varied[];
}

export const BLANK: Form = {
  preset: undefined,
  seed: "",
  changes: {},
  labels: [],
  outputs: DEFAULT_OUTPUTS,
  bodies: DEFAULT_BODIES,
  units: "habit",
  backend: "auto",
  priority: "0",
  reuse: true,
  purpose: "model",
  seeds: "drawn",
  seedCount: "5",
  seedList: "1..5",
  design: "grid",
  samples: "20",
  varied: [],
};

export type Request = { purpose: "model"; body: ModelRequest } | { purpose: "study"; body: BatchRequest };

/**
 * The request of the form, or the faults that only the form can detect, at the service's pointers.
 */
export function requestOf(form: Form, preset: string, parameters: readonly Parameter[]): Request | Fault[] {
  const faults: Fault[] = [];
  const number = (text: string, pointer: string): number => {
    const value = readNumber(text);
    if (Number.isNaN(value)) faults.push({ pointer, detail: text.trim() === "" ? "is missing" : NO_NUMBER });
    return value;
  };
  const body: Json = { preset };
  for (const { pointer, kind } of parameters) {
    const value = form.changes[pointer];
    const points = kind.type === "points" && value !== undefined ? readPoints(String(value), kind.coordinates) : undefined;
    if (typeof points === "string") faults.push({ pointer: `/spec${pointer}`, detail: points });
    else faults.push(...notNumbers(value, `/spec${pointer}`));
  }
  const spec = specPatch(form.changes, parameters);
  if (Object.keys(spec).length > 0) body["spec"] = spec;
  if (form.outputs.join() !== DEFAULT_OUTPUTS.join()) body["outputs"] = form.outputs;
  if (form.bodies.join() !== DEFAULT_BODIES.join()) body["bodies"] = form.bodies;
  if (form.units !== "habit") body["units"] = form.units;
  const labels = form.labels.filter(({ name, value }) => name !== "" || value !== "");
  if (labels.length > 0) body["labels"] = Object.fromEntries(labels.map(({ name, value }) => [name, value]));
  for (const [i, { name }] of labels.entries()) {
    const given = labels.findIndex((other) => other.name === name) < i;
    if (given) faults.push({ pointer: `/labels/${escaped(name)}`, detail: `the name “${name}” is given twice` });
  }
  if (form.backend !== "auto") body["backend"] = form.backend;
  const priority = number(form.priority, "/priority");
  if (priority !== 0) body["priority"] = priority;
  if (!form.reuse) body["reuse"] = false;
  if (form.purpose === "model") {
    if (form.seed.trim() !== "") body["seed"] = number(form.seed, "/seed");
  } else {
    addStudy({ ...form, varied: variedOf(form, parameters) }, body, number, faults);
  }
  if (faults.length > 0) return faults;
  // The service validates the members beyond their types.
  return { purpose: form.purpose, body } as Request;
}

/** The varied parameters that the current preset has. Others are kept for another preset. */
export function variedOf({ varied }: Form, parameters: readonly Parameter[]): readonly Varied[] {
  const pointers = new Set(parameters.map(({ pointer }) => pointer));
  return varied.filter(({ pointer }) => pointers.has(pointer));
}

const NO_NUMBER = "must be a number; write decimals with a point";

function addStudy(form: Form, body: Json, number: (text: string, pointer: string) => number, faults: Fault[]): void {
  if (form.seeds === "given") {
    const seeds = readSeeds(form.seedList);
    if (typeof seeds === "string") faults.push({ pointer: "/seeds", detail: seeds });
    else body["seeds"] = seeds;
  } else if (form.seeds === "drawn") {
    body["count"] = number(form.seedCount, "/count");
  } else if (form.varied.length === 0) {
    body["count"] = 1;
  }
  if (form.varied.length === 0) return;
  const lhs = form.design === "lhs";
  const values = form.varied.map((varied): [string, unknown] => {
    if (varied.values === "list") {
      const list = readList(varied.list);
      if (typeof list === "string") faults.push({ pointer: variedPointer(varied.pointer), detail: list });
      return [varied.pointer, list];
    }
    const read = (member: (typeof RANGE)[number]) => number(varied[member], variedPointer(varied.pointer, member));
    const ends = { from: read("from"), to: read("to") };
    return [varied.pointer, lhs ? ends : { ...ends, count: read("count") }];
  });
  body["vary"] = {
    design: form.design,
    ...(lhs ? { samples: number(form.samples, "/vary/samples") } : {}),
    values: Object.fromEntries(values),
  };
}

/**
 * JSON pointer in the request for the values of a varied parameter, or for one of their members.
 */
export function variedPointer(pointer: string, member?: (typeof RANGE)[number]): string {
  return `/vary/values/${escaped(pointer)}${member === undefined ? "" : `/${member}`}`;
}
export const RANGE = ["from", "to", "count"] as const;

function escaped(segment: string): string {
  return segment.replaceAll("~", "~0").replaceAll("/", "~1");
}

function notNumbers(value: Value | undefined, pointer: string): Fault[] {
  if (value === undefined) return [];
  if (!isSchedule(value)) return Number.isNaN(value) ? [{ pointer, detail: NO_NUMBER }] : [];
  const { keys, fluctuation } = value;
  return [
    ...keys.flatMap((key, i) => key.flatMap((part, k) => notNumbers(part, `${pointer}/keys/${i}/${k}`))),
    ...notNumbers(fluctuation?.amplitude, `${pointer}/fluctuation/amplitude`),
    ...notNumbers(fluctuation?.period, `${pointer}/fluctuation/period`),
  ];
}

/**
 * Initial values of a varied parameter: a fifth below and above the preset's value, within bounds.
 */
export function variedFrom({ pointer, kind, preset }: Parameter): Varied {
  const blank: Varied = { pointer, values: "list", from: "", to: "", count: "5", list: "" };
  if (kind.type === "points") return blank;
  if (kind.type === "flag") return { ...blank, list: "false, true" };
  if (kind.type === "choice") return { ...blank, list: kind.choices.map(({ name }) => name).join(", ") };
  const values = isSchedule(preset) ? preset.keys.map(([, value]) => value) : [Number(preset)];
  const { minimum = -Infinity, maximum = Infinity } = kind.bounds;
  const within = (value: number) => {
    const bounded = Math.min(Math.max(value, minimum), maximum);
    return String(kind.type === "number" && kind.integer ? Math.round(bounded) : Number(bounded.toPrecision(3)));
  };
  return { ...blank, values: "range", from: within(0.8 * Math.min(...values)), to: within(1.2 * Math.max(...values)) };
}
