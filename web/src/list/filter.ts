// Conditions of the list of models, as in the link.
import type { ModelFilter, ModelState, Status } from "oviduct-client";

export const STATUSES: readonly Status[] = ["queued", "running", "succeeded", "failed", "cancelled"];
/** Periods that end at the current time, in hours. */
export const PERIODS = { hour: 1, day: 24, week: 168, month: 720 } as const;
export type Period = keyof typeof PERIODS;

export interface Filter {
  status?: Status;
  preset?: string;
  /** `name:value`. */
  labels: string[];
  batch?: string;
  within?: Period;
}

export function readFilter(query: URLSearchParams): Filter {
  const labels = query.getAll("label").filter((label) => label.indexOf(":") > 0);
  const filter: Filter = { labels: labels.reduce<string[]>((kept, label) => withLabel(kept, label), []) };
  const status = STATUSES.find((name) => name === query.get("status"));
  const within = Object.keys(PERIODS).find((name): name is Period => name === query.get("within"));
  const [preset, batch] = [query.get("preset"), query.get("batch")];
  if (status) filter.status = status;
  if (preset) filter.preset = preset;
  if (batch) filter.batch = batch;
  if (within) filter.within = within;
  return filter;
}

export function writeFilter({ labels, ...rest }: Filter): URLSearchParams {
  const query = new URLSearchParams(Object.entries(rest).filter(([, value]) => value !== undefined));
  for (const label of labels) query.append("label", label);
  return query;
}

/** Adds a label, replacing another value of the same name. */
export function withLabel(labels: readonly string[], label: string): string[] {
  const [name] = split(label);
  return [...labels.filter((other) => split(other)[0] !== name), label];
}

export function isEmpty(filter: Filter): boolean {
  return writeFilter(filter).size === 0;
}

/** The conditions for the service; `now` is in milliseconds. */
export function conditions({ status, preset, labels, batch, within }: Filter, now: number): ModelFilter {
  const after = within && new Date(now - PERIODS[within] * 3_600_000);
  const own = Object.fromEntries(labels.map(split));
  return { status, preset, batch, created_after: after, labels: labels.length > 0 ? own : undefined };
}

export function hasConditions(which: ModelFilter): boolean {
  return Object.values(which).some((value) => value !== undefined);
}

/** True if a model meets the conditions, by the rules of the service. */
export function matches(model: ModelState, { status, preset, labels = {}, batch, created_after: after }: ModelFilter): boolean {
  return (
    (status === undefined || model.status === status) &&
    (preset === undefined || model.preset === preset) &&
    (batch === undefined || model.batch === batch) &&
    (after === undefined || Date.parse(model.created_at) >= new Date(after).getTime()) &&
    Object.entries(labels).every(([name, value]) => model.labels[name] === value)
  );
}

function split(label: string): [string, string] {
  const colon = label.indexOf(":");
  return [label.slice(0, colon), label.slice(colon + 1)];
}
