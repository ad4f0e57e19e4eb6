// The event stream of the page, kept open across restarts of the service, lost networks and sleep.
import { batch, effect, signal, untracked } from "@preact/signals";
import { Oviduct, OviductError } from "oviduct-client";
import { receive, reset } from "./models.ts";
import { base, key, locked, noteRefusal, session } from "./service.ts";

export type Connection = "connecting" | "live" | "lost" | "refused";
/**
 * State of the event stream. `refused` means that the API key may not read it; it is not retried
 * with that key.
 */
export const connection = signal<Connection>("connecting");
/** Reason why there is no stream, while the connection is lost or refused. */
export const fault = signal<unknown>(undefined);
/** Increases with each stream after the first, because data on pages may be outdated. */
export const reconnections = signal(0);

/** Milliseconds after which a refused stream is retried. */
const PAUSE = 3000;
/**
 * Milliseconds of sleep after which the machine opens a new stream, because the old one may be
 * dead.
 */
const ASLEEP = 30_000;
/**
 * Milliseconds after which a hidden page closes its stream.
 *
 * Over HTTP/1.1, a browser shares six connections between all its tabs.
 */
const HIDDEN = 5000;

/** Id of the last received event. */
let last: string | undefined;
let opened = false;

async function follow(key: string | undefined, signal: AbortSignal): Promise<void> {
  const watched: typeof fetch = async (input, init) => {
    const response = await fetch(input, init).catch((error: unknown) => {
      if (!signal.aborted) lose(error);
      throw error;
    });
    if (signal.aborted) return response;
    if (response.ok) opens();
    // Do not wait, because the client reads the same response.
    else void OviductError.of(response.clone()).then((error) => signal.aborted || lose(error), lose);
    return response;
  };
  // Use `fetch`, because an `EventSource` hides the comments that distinguish a live stream from a
  // dead one.
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
      lose(error);
      noteRefusal(error);
      if (connection.peek() === "refused") return;
    }
    await new Promise((resolve) => setTimeout(resolve, PAUSE));
  }
}

function opens(): void {
  if (opened) reconnections.value++;
  opened = true;
  // With an unknown id, the stream also reports models that ended while there was no stream.
  last ??= "none";
  connection.value = "live";
}

function lose(why: unknown): void {
  batch(() => {
    fault.value = why;
    connection.value = why instanceof OviductError && why.is("forbidden") ? "refused" : "lost";
  });
}

/** Follows all models while the page is visible. */
export function watch(): void {
  let abort = new AbortController();
  const restart = () => {
    abort.abort();
    if (locked.peek() !== undefined || connection.peek() === "refused" || document.hidden) return;
    abort = new AbortController();
    void follow(key.peek(), abort.signal);
  };
  let owner = session.peek();
  effect(() => {
    const present = session.value;
    const open = locked.value === undefined;
    untracked(() => {
      if (present !== owner) {
        owner = present;
        last = undefined;
        connection.value = "connecting";
        reset();
      }
      if (open) restart();
      else abort.abort();
    });
  });
  let hidden = 0;
  let closing: ReturnType<typeof setTimeout> | undefined;
  document.addEventListener("visibilitychange", () => {
    clearTimeout(closing);
    if (document.hidden) {
      hidden = Date.now();
      closing = setTimeout(() => abort.abort(), HIDDEN);
    } else if (abort.signal.aborted || Date.now() - hidden > ASLEEP) {
      restart();
    }
  });
  // Such a late timer means that the machine slept. Browsers also delay the timers of hidden pages,
  // which are handled above.
  let awake = Date.now();
  setInterval(() => {
    const asleep = Date.now() - awake > ASLEEP;
    awake = Date.now();
    if (asleep && !document.hidden) restart();
  }, ASLEEP / 6);
  addEventListener("online", restart);
}
