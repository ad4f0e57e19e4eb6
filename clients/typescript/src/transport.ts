import { OviductConnectionError, OviductError } from "./errors.js";

/** Values of a query; those that are undefined are left out, a list is repeated. */
export type Query = Record<string, string | number | boolean | readonly string[] | undefined>;

/** A request below the base URL. */
export interface Call {
  method: "GET" | "POST" | "DELETE";
  /** Path of the service without its first slash, such as `models/7`. */
  path: string;
  query?: Query;
  /** Sent as JSON. */
  body?: unknown;
  headers?: Record<string, string>;
  signal?: AbortSignal | undefined;
  /** Milliseconds to add to the time that one attempt may take. */
  held?: number;
  /** Whether it is sent once only. */
  once?: boolean;
}

/** Called with the number of bytes that one attempt has received so far. */
export type OnProgress = (received: number) => void;

/** Reads what one attempt answered; `body` gives the whole body. */
export type Read<T> = (response: Response, body: (onProgress?: OnProgress) => Promise<ArrayBuffer>) => Promise<T> | T;

/** How requests are sent. */
export interface Settings {
  key: string | undefined;
  fetch: typeof fetch;
  /** Milliseconds until an answer must begin, and that its body may then pause. */
  timeout: number;
  attempts: number;
  maxDelay: number;
}

/** Delay of the first retry, in milliseconds. */
const FIRST_DELAY = 500;
/** Statuses that a later attempt may not have. */
const TRANSIENT = [408, 429, 502, 503, 504];

/** Sends requests, and repeats them while that may help. All requests of this client are safe to repeat. */
export class Transport {
  readonly base: URL;
  readonly #settings: Settings;

  constructor(url: string | URL, settings: Settings) {
    this.base = new URL(url);
    // `fetch` refuses such URLs with a message that quotes them.
    if (this.base.username || this.base.password) throw new TypeError("the URL must not contain a name or password");
    // A header that is no text is refused with a message that quotes it.
    if (settings.key !== undefined && !/^[!-~]+$/.test(settings.key)) {
      throw new TypeError("the key has characters that a key cannot have");
    }
    this.base.search = this.base.hash = "";
    if (!this.base.pathname.endsWith("/")) this.base.pathname += "/";
    this.#settings = settings;
  }

  get hasKey(): boolean {
    return this.#settings.key !== undefined;
  }

  get timeout(): number {
    return this.#settings.timeout;
  }

  url(path: string, query: Query = {}): URL {
    const url = new URL(path, this.base);
    for (const [name, value] of Object.entries(query)) {
      if (value === undefined) continue;
      for (const one of Array.isArray(value) ? value : [value]) url.searchParams.append(name, String(one));
    }
    return url;
  }

  /** The JSON of an answer; undefined if it has none. References to files are made absolute. */
  async json<T>(call: Call): Promise<T> {
    const [text, url] = await this.send(call, async (response, body) => [
      new TextDecoder().decode(await body()),
      response.url || this.url(call.path, call.query).href,
    ]);
    if (text === "") return undefined as T;
    try {
      return absolute(JSON.parse(text), url) as T;
    } catch (cause) {
      throw new OviductConnectionError(`${call.method} /${call.path}: the answer is not JSON`, { cause });
    }
  }

  /** Sends a request and reads the answer, again and again while that may help. */
  async send<T>(call: Call, read: Read<T>): Promise<T> {
    let lost = false;
    for (let attempt = 1; ; attempt++) {
      try {
        return await this.#attempt(call, read);
      } catch (error) {
        // An earlier attempt may have deleted it, if its answer was lost; one that was refused has not.
        if (call.method === "DELETE" && lost && error instanceof OviductError && error.status === 404) {
          return await read(new Response(null, { status: 204 }), () => Promise.resolve(new ArrayBuffer(0)));
        }
        lost ||= error instanceof OviductConnectionError;
        const wait = this.delay(attempt, error);
        if (call.once || attempt >= this.#settings.attempts || wait === undefined) throw error;
        await sleep(wait, call.signal);
      }
    }
  }

  /** Milliseconds to wait after the given number of failures; undefined if waiting does not help, or not soon. */
  delay(failures: number, error?: unknown): number | undefined {
    const { maxDelay } = this.#settings;
    if (error instanceof OviductError) {
      if (!TRANSIENT.includes(error.status)) return undefined;
      const asked = (error.retryAfter ?? 0) * 1000;
      if (asked > maxDelay) return undefined;
      if (asked > 0) return asked;
    } else if (error !== undefined && !(error instanceof OviductConnectionError)) {
      return undefined;
    }
    // Clients of one service must not come back all at once.
    return Math.min(maxDelay, FIRST_DELAY * 2 ** (failures - 1)) * (0.5 + Math.random() / 2);
  }

  async #attempt<T>(call: Call, read: Read<T>): Promise<T> {
    const { key, timeout } = this.#settings;
    const url = this.url(call.path, call.query);
    const headers = new Headers(call.headers);
    if (key !== undefined) headers.set("authorization", `Bearer ${key}`);
    const init: RequestInit = { method: call.method, headers };
    if (call.body !== undefined) {
      headers.set("content-type", "application/json");
      init.body = JSON.stringify(call.body);
    }
    const name = `${call.method} ${url.origin}${url.pathname}`;
    call.signal?.throwIfAborted();
    const late = new AbortController();
    const timer = setTimeout(() => late.abort(), timeout + (call.held ?? 0));
    init.signal = call.signal ? AbortSignal.any([call.signal, late.signal]) : late.signal;
    try {
      const response = await this.#settings.fetch(url.href, init);
      if (!response.ok) throw await OviductError.of(response);
      // A large body may take longer, as long as it goes on.
      clearTimeout(timer);
      return await read(response, (onProgress) => readBody(response, timeout, onProgress));
    } catch (cause) {
      if (cause instanceof OviductError || cause instanceof OviductConnectionError) throw cause;
      call.signal?.throwIfAborted();
      if (late.signal.aborted) throw new OviductConnectionError(`${name}: no answer within ${timeout} ms`);
      throw new OviductConnectionError(`${name}: no complete answer`, { cause });
    } finally {
      clearTimeout(timer);
    }
  }
}

/** The whole body. Fails if nothing of it comes for so many milliseconds. */
async function readBody(response: Response, limit: number, onProgress?: OnProgress): Promise<ArrayBuffer> {
  // Some implementations of `fetch` have no streams: the limit is then for the whole.
  if (!response.body) return orSilence(response.arrayBuffer(), limit);
  const reader = response.body.getReader();
  const chunks: Uint8Array[] = [];
  let length = 0;
  try {
    for (;;) {
      const { done, value } = await orSilence(reader.read(), limit);
      if (done) break;
      chunks.push(value);
      length += value.length;
      onProgress?.(length);
    }
  } finally {
    // Not awaited: what is silent may not answer this either.
    reader.cancel().catch(() => {});
  }
  const bytes = new Uint8Array(length);
  let at = 0;
  for (const chunk of chunks) {
    bytes.set(chunk, at);
    at += chunk.length;
  }
  return bytes.buffer;
}

/** The result, unless it does not come within so many milliseconds. */
export async function orSilence<T>(read: Promise<T>, limit: number): Promise<T> {
  let timer: ReturnType<typeof setTimeout> | undefined;
  const silence = new Promise<never>((_, reject) => {
    timer = setTimeout(() => reject(new Error(`nothing came for ${limit} ms`)), limit);
  });
  try {
    return await Promise.race([read, silence]);
  } finally {
    clearTimeout(timer);
  }
}

/** Waits; throws `signal.reason` if the signal is aborted. */
export function sleep(milliseconds: number, signal?: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    const stop = () => {
      clearTimeout(timer);
      reject(signal?.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, milliseconds);
    if (signal?.aborted) stop();
    signal?.addEventListener("abort", stop, { once: true });
  });
}

type WithFiles = { files?: { href?: unknown }[]; models?: unknown };

/** Makes the references to files in a model, or in a list of models, absolute: the service gives them relative to the answer. */
export function absolute(value: unknown, url: string): unknown {
  if (typeof value !== "object" || value === null) return value;
  const { files, models } = value as WithFiles;
  if (Array.isArray(files)) {
    for (const file of files) if (typeof file.href === "string") file.href = new URL(file.href, url).href;
  }
  if (Array.isArray(models)) for (const model of models) absolute(model, url);
  return value;
}
