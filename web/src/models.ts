// What is known of the models: from the event stream (stream.ts), and from what pages have read.
import { batch, signal, type Signal } from "@preact/signals";
import type { Model, ModelEvent, ModelState } from "oviduct-client";

/** A contour: x and y of each point in turn, micrometres. */
export type Contour = Float32Array;

/** A section of a growing tube, thinned for drawing. */
export interface LiveSection {
  /** Index among the recorded sections. */
  index: number;
  step: number;
  z_um: number;
  /** Unknown of a section from before the page was loaded again. */
  inner?: Contour;
  outer: Contour;
}

/** Grows when a model appears, goes or changes its status. */
export const changes = signal(0);

/** Ids of the known models, in the order of acceptance: they are UUIDv7. */
const order: string[] = [];
/** Those that were read or changed last are last. */
const states = new Map<string, Signal<ModelState | undefined>>();
/** Models that something on the page shows. */
const shown = new Set<string>();
const growing = new Map<string, Signal<readonly LiveSection[]>>();
/** Models that were deleted: an answer that was on its way must not bring them back. */
const deleted = new Set<string>();
/** Models that are kept, if not more are shown. */
export const KEPT = 2000;
/** How many were dropped: lists that were read before may lack some. */
export let drops = 0;
/** Ended models whose sections are kept. */
const ENDED_KEPT = 4;

/** The newest known state of a model; undefined if nothing is known, or it was deleted. */
export function state(id: string): Signal<ModelState | undefined> {
  let known = states.get(id);
  if (!known) {
    known = signal(undefined, { watched: () => shown.add(id), unwatched: () => shown.delete(id) });
    states.set(id, known);
  }
  return known;
}

/** All known models, newest first. Reading it in a component subscribes to `changes`, not to the progress of each model. */
export function* known(): Generator<ModelState, void> {
  void changes.value;
  for (let k = order.length - 1; k >= 0; k--) yield states.get(order[k]!)!.peek()!;
}

/** The number of known models that were accepted before this one. */
function olderThan(id: string): number {
  let [from, to] = [0, order.length];
  while (from < to) {
    const middle = (from + to) >> 1;
    if (order[middle]! < id) from = middle + 1;
    else to = middle;
  }
  return from;
}

/** The sections of a growing model that were seen, from the isthmus. */
export function sections(id: string): Signal<readonly LiveSection[]> {
  let seen = growing.get(id);
  if (!seen) growing.set(id, (seen = signal([])));
  return seen;
}

/** Takes over states that were read, unless newer ones are known. */
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

/** Drops the models that were touched least recently and are not shown, if there are too many. */
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

/** Removes a model that was deleted. */
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

/** Forgets everything: another key sees other models. */
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

/** Milliseconds for which events are gathered before pages are drawn again. */
const GATHERING = 50;
let waiting: ModelEvent[] = [];
let timer: ReturnType<typeof setTimeout> | undefined;

/** Takes over an event of the stream, soon. */
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
  // A model that starts again from an earlier step repeats sections.
  seen.value = [...seen.peek().filter((other) => other.index < section.index), section];
  const ended = [...growing.keys()].filter((other) => states.get(other)?.peek()?.status !== "running");
  for (const other of ended.slice(0, -ENDED_KEPT)) growing.delete(other);
}
