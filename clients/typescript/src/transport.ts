import { OviductConnectionError, OviductError } from "./errors.js";

/** Query parameters; undefined values are omitted, and a list repeats its parameter. */
export type Query = Record<string, string | number | boolean | readonly string[] | undefined>;

/** A request below the base URL. */
export interface Call {
  method: "GET" | "POST" | "DELETE";
  /** Path of the service without its leading slash, such as `models/7`. */
  path: string;
  query?: Query;
  /** Sent as JSON. */
  body?: unknown;
  headers?: Record<string, string>;
  signal?: AbortSignal | undefined;
  /**
   * Milliseconds to add to the time limit of an attempt, because the service holds its response.
   */
  held?: number;
  /** True to send the request only once. */
  once?: boolean;
}

/** Called with the number of bytes that the current attempt has received so far. */
export type OnProgress = (received: number) => void;

/** Reads the response of one attempt; `body` returns the whole body. */
export type Read<T> = (response: Response, body: (onProgress?: OnProgress) => Promise<ArrayBuffer>) => Promise<T> | T;

/** Settings for sending requests. */
export interface Settings {
  key: string | undefined;
  fetch: typeof fetch;
  /** Maximum wait for the beginning of a response, and for its next bytes, milliseconds. */
  timeout: number;
  attempts: number;
  maxDelay: number;
}

/** Delay of the first retry, milliseconds. */
const FIRST_DELAY = 500;
/** Statuses after which a retry can succeed. */
const TRANSIENT = [408, 429, 502, 503, 504];

/**
 * Sends requests and retries them after transient errors. All requests of this client can be
 * retried safely.
 */
export class Transport {
  readonly base: URL;
  readonly #settings: Settings;

  constructor(url: string | URL, settings: Settings) {
    this.base = new URL(url);
    // `fetch` refuses such URLs, and its message would quote them.
    if (this.base.username || this.base.password) throw new TypeError("the URL must not contain a name or password");
    // `fetch` refuses a header with other characters, and its message would quote the API key.
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

  /**
   * Returns the JSON of a response, with absolute references to files; undefined for an empty body.
   */
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

  /** Sends a request and reads the response; retries after transient errors. */
  async send<T>(call: Call, read: Read<T>): Promise<T> {
    let lost = false;
    for (let attempt = 1; ; attempt++) {
      try {
        return await this.#attempt(call, read);
      } catch (error) {
        // If the response of an earlier attempt was lost, that attempt may have deleted the
        // resource.
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

  /**
   * Returns the milliseconds to wait after this many failures; undefined if a retry is useless or
   * too late.
   */
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
    // The random part keeps clients of one service from retrying together.
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
      // A large body may take longer, as long as bytes keep arriving.
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

/** Returns the whole body; fails if no bytes arrive for `limit` milliseconds. */
async function readBody(response: Response, limit: number, onProgress?: OnProgress): Promise<ArrayBuffer> {
  // Some implementations of `fetch` have no streams; the limit then applies to the whole body.
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
    // Do not wait: a silent connection may not respond to this either.
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

/** Returns the result; fails if it takes more than `limit` milliseconds. */
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

/**
 * Makes the file references in one or more models absolute; the service sends them relative to the
 * response.
 */
export function absolute(value: unknown, url: string): unknown {
  if (typeof value !== "object" || value === null) return value;
  const { files, models } = value as WithFiles;
  if (Array.isArray(files)) {
    for (const file of files) if (typeof file.href === "string") file.href = new URL(file.href, url).href;
  }
  if (Array.isArray(models)) for (const model of models) absolute(model, url);
  return value;
}
