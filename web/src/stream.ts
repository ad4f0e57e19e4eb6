// The one event stream of the page, kept open through restarts of the service, lost networks and sleep.
import { effect, signal, untracked } from "@preact/signals";
import { Oviduct } from "oviduct-client";
import { receive, reset } from "./models.ts";
import { base, key, locked, noteRefusal } from "./service.ts";

export type Connection = "connecting" | "live" | "lost";
/** State of the event stream. */
export const connection = signal<Connection>("connecting");
/** Grows with each stream that was opened after the first: what pages have read may be outdated. */
export const reconnections = signal(0);

/** Milliseconds after which a stream that was refused is asked for again. */
const PAUSE = 3000;
/** Milliseconds after which a machine that slept, or a hidden page, opens a new stream: the old one may be dead unnoticed. */
const ASLEEP = 30_000;

/** The last event that was seen. */
let last: string | undefined;
let opened = false;

async function follow(key: string | undefined, signal: AbortSignal): Promise<void> {
  const watched: typeof fetch = async (input, init) => {
    const response = await fetch(input, init).catch((error: unknown) => {
      if (!signal.aborted) connection.value = "lost";
      throw error;
    });
    if (!signal.aborted) note(response.ok);
    return response;
  };
  // By `fetch`, for an `EventSource` does not show the comments by which a live stream is told from a dead one.
  const options = { key, fetch: watched, eventSource: null, reconnects: Infinity, maxDelay: PAUSE, timeout: 10_000 };
  const service = new Oviduct(base, options);
  while (!signal.aborted) {
    try {
      for await (const event of service.follow({}, { signal, view: "summary", lastEventId: last })) {
        if (signal.aborted) return;
        last = event.id;
        receive(event);
      }
    } catch (error) {
      if (signal.aborted) return;
      connection.value = "lost";
      noteRefusal(error);
    }
    await new Promise((resolve) => setTimeout(resolve, PAUSE));
  }
}

function note(open: boolean): void {
  if (open && opened) reconnections.value++;
  opened ||= open;
  // An unknown id also brings the models that ended while there was no stream.
  if (open) last ??= "none";
  connection.value = open ? "live" : "lost";
}

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
    const present = key.value;
    const open = locked.value === undefined;
    untracked(() => {
      if (present !== owner) {
        owner = present;
        last = undefined;
        reset();
      }
      if (open) restart();
      else abort.abort();
    });
  });
  let hidden = 0;
  document.addEventListener("visibilitychange", () => {
    if (document.hidden) hidden = Date.now();
    else if (Date.now() - hidden > ASLEEP) restart();
  });
  // A timer that is late by so much has slept. Browsers also slow down the timers of hidden pages; those are handled above.
  let awake = Date.now();
  setInterval(() => {
    const asleep = Date.now() - awake > ASLEEP;
    awake = Date.now();
    if (asleep && !document.hidden) restart();
  }, ASLEEP / 6);
  addEventListener("online", restart);
}
