import { OviductConnectionError } from "./errors.js";
import { orSilence } from "./transport.js";

/** A server-sent event. An id without data has the type "". */
export interface RawEvent {
  type: string;
  id: string;
  data: string;
}

/** The part of `EventSource` that this client uses. */
export interface EventSourceLike {
  addEventListener(type: string, listener: (event: never) => void): void;
  close(): void;
}
export type EventSourceClass = new (url: string) => EventSourceLike;

/** Event names of the service. */
const TYPES = ["status", "progress", "section", "end"];
/** Limits of a stream in milliseconds; members of an object, so that tests can shorten them. */
export const LIMITS = {
  /** Silence after which a stream counts as broken. The service sends a comment every 15 s. */
  silence: 60_000,
  /**
   * Time without an event after which an `EventSource` is closed.
   *
   * An `EventSource` hides comments, so it may be broken.
   */
  quiet: 300_000,
  /** Time after which an open stream counts as success, even without events. */
  lasting: 5000,
};

/**
 * Opens an `EventSource`; returns undefined if the service refused it, without a reason.
 *
 * The `EventSource` never reconnects by itself, because its ticket is valid for one connection. The
 * events end when the connection breaks or is quiet for too long.
 *
 * @param timeout Milliseconds until the stream must be open.
 */
export async function openEventSource(
  EventSource: EventSourceClass,
  url: string,
  timeout: number,
  signal?: AbortSignal,
): Promise<AsyncGenerator<RawEvent, void> | undefined> {
  const source = new EventSource(url);
  // Keep only the newest event per model and type: each contains the whole state, and the reader
  // may be slow.
  const queue = new Map<string, RawEvent>();
  let state: "opening" | "open" | "over" = "opening";
  let late = false;
  let timer: ReturnType<typeof setTimeout> | undefined;
  let wake = () => {};
  const change = () => new Promise<void>((resolve) => (wake = resolve));
  const stop = () => {
    state = "over";
    clearTimeout(timer);
    source.close();
    wake();
  };
  const stopAfterQuiet = () => {
    clearTimeout(timer);
    timer = setTimeout(stop, LIMITS.quiet);
  };
  timer = setTimeout(() => {
    late = true;
    stop();
  }, timeout);
  source.addEventListener("open", () => {
    if (state !== "opening") return;
    state = "open";
    stopAfterQuiet();
    wake();
  });
  source.addEventListener("error", stop);
  for (const type of TYPES) {
    source.addEventListener(type, (event: MessageEvent<string>) => {
      const key = `${type} ${(JSON.parse(event.data) as { id: string }).id}`;
      queue.delete(key);
      queue.set(key, { type, id: event.lastEventId, data: event.data });
      if (state === "open") stopAfterQuiet();
      wake();
    });
  }
  if (signal?.aborted) stop();
  signal?.addEventListener("abort", stop, { once: true });
  const opened = () => state === "open" || queue.size > 0;
  while (state === "opening") await change();
  if (!opened()) {
    signal?.removeEventListener("abort", stop);
    signal?.throwIfAborted();
    if (late) throw new OviductConnectionError(`the event stream did not open within ${timeout} ms`);
    return undefined;
  }
  return (async function* () {
    try {
      for (;;) {
        signal?.throwIfAborted();
        const [first] = queue;
        if (first) {
          queue.delete(first[0]);
          yield first[1];
        } else if (state === "over") {
          return;
        } else {
          await change();
        }
      }
    } finally {
      signal?.removeEventListener("abort", stop);
      stop();
    }
  })();
}

/**
 * Reads a body as server-sent events (WHATWG HTML, section 9.2.6).
 *
 * Cancels the body when the reader stops.
 */
export async function* readEvents(body: ReadableStream<Uint8Array>): AsyncGenerator<RawEvent, void> {
  const reader = body.getReader();
  const decoder = new TextDecoder();
  let rest = "";
  let [type, data, id] = ["", "", ""];
  let named = false;
  try {
    for (;;) {
      const chunk = await orSilence(reader.read(), LIMITS.silence).catch((cause: unknown) => {
        throw new OviductConnectionError("the event stream broke off", { cause });
      });
      if (chunk.done) return;
      rest += decoder.decode(chunk.value, { stream: true });
      // A carriage return at the end may be the first half of a line end.
      const lines = rest.split(/\r\n|\n|\r(?!$)/);
      rest = lines.pop() ?? "";
      for (const line of lines) {
        if (line === "") {
          if (data !== "") yield { type: type || "message", id, data: data.slice(0, -1) };
          else if (named) yield { type: "", id, data };
          [type, data, named] = ["", "", false];
          continue;
        }
        const colon = line.indexOf(":");
        const field = colon < 0 ? line : line.slice(0, colon);
        const value = colon < 0 ? "" : line.slice(colon + 1).replace(/^ /, "");
        if (field === "event") type = value;
        else if (field === "data") data += `${value}\n`;
        else if (field === "id" && !value.includes("\0")) [id, named] = [value, true];
      }
    }
  } finally {
    await reader.cancel().catch(() => {});
  }
}
