// Known states of models, from the event stream (stream.ts) and from requests of pages.
import { batch, signal, type Signal } from "@preact/signals";
import type { Model, ModelEvent, ModelState } from "oviduct-client";

/** A contour: x and y of the points alternately, micrometres. */
export type Contour = Float32Array;

/** A section of a growing tube, thinned for drawing. */
export interface LiveSection {
  /** Index among the recorded sections. */
  index: number;
  step: number;
  z_um: number;
  /** Undefined for a section from before a reload of the page. */
  inner?: Contour;
  outer: Contour;
}

/** Increases when a model appears, disappears or changes its status. */
export const changes = signal(0);

/** Ids of the known models in the order of acceptance, because ids are UUIDv7. */
const order: string[] = [];
/** States of models; the least recently read or changed come first. */
const states = new Map<string, Signal<ModelState | undefined>>();
/** Ids of the models that the page shows. */
const shown = new Set<string>();
const growing = new Map<string, Signal<readonly LiveSection[]>>();
/** Ids of deleted models. A response that was under way must not restore them. */
const deleted = new Set<string>();
/** Number of kept models, unless more are shown. */
export const KEPT = 2000;
/** Number of dropped models. Lists that were read earlier may lack some. */
export let drops = 0;
/** Number of ended models whose sections are kept. */
const ENDED_KEPT = 4;

/** The newest known state of a model; undefined if it is unknown or deleted. */
export function state(id: string): Signal<ModelState | undefined> {
  let known = states.get(id);
  if (!known) {
    known = signal(undefined, { watched: () => shown.add(id), unwatched: () => shown.delete(id) });
    states.set(id, known);
  }
  return known;
}

/**
 * All known models, newest first.
 *
 * A component that reads them subscribes to `changes`, not to the progress of each model.
 */
export function* known(): Generator<ModelState, void> {
  void changes.value;
  for (let k = order.length - 1; k >= 0; k--) yield states.get(order[k]!)!.peek()!;
}

/** Number of known models that were accepted before this one. */
function olderThan(id: string): number {
  let [from, to] = [0, order.length];
  while (from < to) {
    const middle = (from + to) >> 1;
    if (order[middle]! < id) from = middle + 1;
    else to = middle;
  }
  return from;
}

/** Received sections of a growing model, isthmus end first. */
export function sections(id: string): Signal<readonly LiveSection[]> {
  let seen = growing.get(id);
  if (!seen) growing.set(id, (seen = signal([])));
  return seen;
}

/** Stores states that were read, unless newer ones are known. */
export function remember(models: readonly (Model | ModelState)[]): void {
  batch(() => {
    for (const model of models) {
      if (deleted.has(model.id)) continue;
      const known = state(model.id);
      const before = known.peek();
      // The place in the queue changes without a new version.
      if (before && before.version > model.version) continue;
      if (!before) order.splice(olderThan(model.id), 0, model.id);
      known.value = model;
      states.delete(model.id);
      states.set(model.id, known);
      if (before?.status !== model.status) bump();
    }
  });
  drop();
}

/** Drops the least recently used models that are not shown, if there are too many. */
function drop(): void {
  if (states.size <= KEPT) return;
  for (const [id, known] of states) {
    if (states.size <= KEPT) return;
    if (shown.has(id)) continue;
    states.delete(id);
    growing.delete(id);
    if (known.peek() === undefined) continue;
    order.splice(olderThan(id), 1);
    drops++;
  }
}

/** Removes a deleted model. */
export function forget(id: string): void {
  deleted.add(id);
  const [oldest] = deleted;
  if (deleted.size > KEPT) deleted.delete(oldest!);
  growing.delete(id);
  const known = states.get(id);
  states.delete(id);
  if (known?.peek() === undefined) return;
  order.splice(olderThan(id), 1);
  batch(() => {
    known.value = undefined;
    bump();
  });
}

/** Forgets all models, because another API key sees other models. */
export function reset(): void {
  waiting = [];
  batch(() => {
    for (const known of states.values()) known.value = undefined;
    states.clear();
    order.length = 0;
    growing.clear();
    deleted.clear();
    bump();
  });
}

function bump(): void {
  changes.value = changes.peek() + 1;
}

/** Milliseconds for which events are collected before pages are rendered. */
const GATHERING = 50;
let waiting: ModelEvent[] = [];
let timer: ReturnType<typeof setTimeout> | undefined;

/** Processes an event of the stream, after a short delay. */
export function receive(event: ModelEvent): void {
  waiting.push(event);
  timer ??= setTimeout(() => {
    timer = undefined;
    const events = waiting;
    waiting = [];
    batch(() => events.forEach(apply));
  }, GATHERING);
}

function apply({ type, model }: ModelEvent): void {
  if (model.status === "deleted") return forget(model.id);
  const { section, ...rest } = model;
  remember([rest]);
  if (type !== "section" || !section || deleted.has(model.id)) return;
  const { index, step, z_um } = section;
  addSection(model.id, { index, step, z_um, inner: contour(section.inner), outer: contour(section.outer) });
}

function contour(points: readonly number[][]): Contour {
  return Float32Array.from(points.flat());
}

function addSection(id: string, section: LiveSection): void {
  const seen = sections(id);
  // A model that resumes from an earlier step repeats sections.
  seen.value = [...seen.peek().filter((other) => other.index < section.index), section];
  const ended = [...growing.keys()].filter((other) => states.get(other)?.peek()?.status !== "running");
  for (const other of ended.slice(0, -ENDED_KEPT)) growing.delete(other);
}
