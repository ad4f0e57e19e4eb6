// What is known of the models: one event stream for the whole page, and whatever pages have read.
import { batch, effect, signal, type Signal } from "@preact/signals";
import { Oviduct, type EventSourceClass, type Model, type ModelState } from "oviduct-client";
import { base, key, locked, noteRefusal } from "./service.ts";

/** A contour of a growing tube, thinned for drawing; micrometres. */
export type LiveSection = NonNullable<ModelState["section"]>;

export type Connection = "connecting" | "live" | "lost";
/** State of the event stream. */
export const connection = signal<Connection>("connecting");
/** Grows with each stream that was opened after the first: what pages have read may be outdated. */
export const reconnections = signal(0);
/** Grows when a model appears that was not known, or goes. */
export const arrivals = signal(0);

const states = new Map<string, Signal<ModelState | undefined>>();
const growing = new Map<string, Signal<readonly LiveSection[]>>();
/** Growing models whose sections are kept. */
const GROWING_KEPT = 16;

/** The newest known state of a model; undefined if nothing is known, or it was deleted. */
export function state(id: string): Signal<ModelState | undefined> {
  let known = states.get(id);
  if (!known) states.set(id, (known = signal(undefined)));
  return known;
}

/** All known models, newest first. Reading it in a component subscribes to arrivals, not to changes of each model. */
export function known(): ModelState[] {
  void arrivals.value;
  const all = [...states.values()].map((state) => state.peek()).filter((model) => model !== undefined);
  // Ids are UUIDv7: their order is that of acceptance.
  return all.sort((a, b) => (a.id < b.id ? 1 : -1));
}

/** The sections of a growing model that were seen since this page was opened, from the isthmus. */
export function sections(id: string): Signal<readonly LiveSection[]> {
  let seen = growing.get(id);
  if (!seen) growing.set(id, (seen = signal([])));
  for (const [oldest] of growing) {
    if (growing.size <= GROWING_KEPT) break;
    growing.delete(oldest);
  }
  return seen;
}

/** Takes over states that were read, unless newer ones are known. */
export function remember(models: readonly (Model | ModelState)[]): void {
  batch(() => {
    for (const model of models) {
      const known = state(model.id);
      const before = known.peek();
      if (before && before.version > model.version) continue;
      known.value = model;
      if (!before) arrivals.value++;
    }
  });
}

/** Removes a model that was deleted. */
export function forget(id: string): void {
  growing.delete(id);
  const known = states.get(id);
  if (known?.peek() === undefined) return;
  batch(() => {
    known.value = undefined;
    states.delete(id);
    arrivals.value++;
  });
}

function addSection(id: string, section: LiveSection): void {
  const seen = sections(id);
  const before = seen.peek();
  // A model that starts again from an earlier step repeats sections.
  const kept = before.filter((other) => other.index < section.index);
  seen.value = [...kept, section];
}

/** An `EventSource` that shows the page whether it is connected. */
class Watched extends EventSource {
  constructor(url: string) {
    super(url);
    this.addEventListener("open", () => {
      if (connection.peek() === "lost") reconnections.value++;
      connection.value = "live";
    });
    this.addEventListener("error", () => (connection.value = "lost"));
  }
}

let last: string | undefined;

async function follow(key: string | undefined, signal: AbortSignal): Promise<void> {
  // The two types differ in how much of an event they describe.
  const eventSource = Watched as unknown as EventSourceClass;
  const service = new Oviduct(base, { key, eventSource, reconnects: Infinity, maxDelay: 3000 });
  try {
    for await (const { type, id, model } of service.follow({}, { signal, view: "summary", lastEventId: last })) {
      last = id;
      if (model.status === "deleted") {
        forget(model.id);
        continue;
      }
      if (type === "section" && model.section) addSection(model.id, model.section);
      remember([model]);
    }
  } catch (error) {
    if (signal.aborted) return;
    connection.value = "lost";
    noteRefusal(error);
  }
}

/** Sleeping machines and hidden tabs lose connections without notice after this time, in milliseconds. */
const ASLEEP = 30_000;

/** Follows all models until the page is left. */
export function watch(): void {
  let abort = new AbortController();
  const restart = () => {
    abort.abort();
    abort = new AbortController();
    if (locked.peek() === undefined) void follow(key.peek(), abort.signal);
  };
  let owner = key.peek();
  effect(() => {
    // Another key sees other models.
    if (key.value !== owner) {
      owner = key.value;
      last = undefined;
      for (const id of [...states.keys()]) forget(id);
    }
    if (locked.value === undefined) restart();
    else abort.abort();
  });
  let hidden = 0;
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) hidden = Date.now();
    else if (Date.now() - hidden > ASLEEP) restart();
  });
  addEventListener("online", restart);
}
