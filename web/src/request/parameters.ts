// Parameters of a spec: kinds and bounds from `GET /schema`, values and sources from `GET
// /presets/{name}`.
import type { Preset } from "oviduct-client";
import { readValue, type Value } from "./schedule.ts";

/** The used part of a JSON Schema. */
export interface SchemaNode {
  type?: string;
  title?: string;
  description?: string;
  enum?: string[];
  minimum?: number;
  maximum?: number;
  minItems?: number;
  maxItems?: number;
  oneOf?: SchemaNode[];
  properties?: Record<string, SchemaNode>;
  items?: SchemaNode;
  prefixItems?: SchemaNode[];
  $ref?: string;
  $defs?: Record<string, SchemaNode>;
  "x-enum-descriptions"?: string[];
  "x-maximum-reason"?: string;
}

export interface Bounds {
  minimum?: number | undefined;
  maximum?: number | undefined;
  /** Reason for the maximum. */
  reason?: string | undefined;
}

export interface Choice {
  name: string;
  description: string | undefined;
}

/** Permitted content of a schedule. */
export interface ScheduleKind {
  type: "schedule";
  bounds: Bounds;
  /** A maximum of 0 forbids a fluctuation. */
  amplitude: Bounds;
  /** Bounds in steps. */
  period: Bounds;
  eases: Choice[];
  mostKeys: number;
}

export type Kind =
  | { type: "number"; integer: boolean; bounds: Bounds }
  | ScheduleKind
  | { type: "choice"; choices: Choice[] }
  | { type: "flag" }
  /** Points with this number of coordinates; 0 for a square of numbers. */
  | { type: "points"; coordinates: number };

export interface Parameter {
  /** JSON pointer into the spec. */
  pointer: string;
  title: string;
  description: string;
  /** Empty if there is none. */
  unit: string;
  source: string | undefined;
  kind: Kind;
  /** Value of the preset. */
  preset: Value;
}

export interface Group {
  /** First segment of the pointers; empty for parameters without a group. */
  name: string;
  title: string;
  description: string | undefined;
  parameters: Parameter[];
}

/** The parameters of a preset, in its order. */
export function parametersOf(schema: SchemaNode, preset: Preset): Parameter[] {
  return preset.parameters.flatMap(({ pointer, title, description, unit, source, value }) => {
    const node = nodeAt(schema, pointer);
    const kind = node && kindOf(node, schema);
    const read = readValue(value);
    if (!kind || read === undefined) return [];
    return [{ pointer, title, description, unit, source: source ?? undefined, kind, preset: read }];
  });
}

/** Parameters grouped by the first segment of their pointers. */
export function groupsOf(schema: SchemaNode, parameters: readonly Parameter[]): Group[] {
  const groups = new Map<string, Group>();
  for (const parameter of parameters) {
    const [, first = "", second] = parameter.pointer.split("/");
    const name = second === undefined ? "" : first;
    const node = schema.properties?.[name];
    let group = groups.get(name);
    if (!group) {
      group = { name, title: node?.title ?? "General", description: node?.description, parameters: [] };
      groups.set(name, group);
    }
    group.parameters.push(parameter);
  }
  return [...groups.values()];
}

function nodeAt(schema: SchemaNode, pointer: string): SchemaNode | undefined {
  let node: SchemaNode | undefined = schema;
  for (const segment of pointer.split("/").slice(1)) {
    node = node && resolved(node, schema).properties?.[segment];
  }
  return node && resolved(node, schema);
}

function kindOf(node: SchemaNode, schema: SchemaNode): Kind | undefined {
  if (node.enum) return { type: "choice", choices: choicesOf(node) };
  if (node.type === "boolean") return { type: "flag" };
  const item = node.type === "array" && node.items ? resolved(node.items, schema) : undefined;
  if (item?.items?.type === "number") return { type: "points", coordinates: item.minItems ?? 0 };
  if (node.type === "number" || node.type === "integer") {
    return { type: "number", integer: node.type === "integer", bounds: boundsOf(node) };
  }
  const constant = node.oneOf?.find(({ type }) => type === "number");
  const schedule = node.oneOf?.map((variant) => resolved(variant, schema)).find(({ properties }) => properties?.["keys"]);
  if (!constant || !schedule) return undefined;
  const fluctuation = resolved(schedule.properties?.["fluctuation"] ?? {}, schema).properties;
  return {
    type: "schedule",
    bounds: boundsOf(constant),
    amplitude: boundsOf(fluctuation?.["amplitude"]),
    period: boundsOf(fluctuation?.["period"]),
    eases: choicesOf(schedule.properties?.["ease"] ?? {}),
    mostKeys: schedule.properties?.["keys"]?.maxItems ?? Infinity,
  };
}

function boundsOf({ minimum, maximum, "x-maximum-reason": reason }: SchemaNode = {}): Bounds {
  return { minimum, maximum, reason };
}

function choicesOf(node: SchemaNode): Choice[] {
  return (node.enum ?? []).map((name, index) => ({ name, description: node["x-enum-descriptions"]?.[index] }));
}

/** A node merged with the target of its `$ref`; its own members take precedence. */
function resolved(node: SchemaNode, schema: SchemaNode): SchemaNode {
  const { $ref, ...own } = node;
  const name = $ref?.replace("#/$defs/", "");
  const definition = name === undefined ? undefined : schema.$defs?.[name];
  return definition ? merged(resolved(definition, schema), own) : node;
}

function merged<T extends object>(below: T, above: T): T {
  const result = { ...below } as Record<string, unknown>;
  for (const [name, value] of Object.entries(above)) {
    const under = result[name];
    result[name] = isObject(under) && isObject(value) ? merged(under, value) : value;
  }
  return result as T;
}

function isObject(value: unknown): value is object {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}
