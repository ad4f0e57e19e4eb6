// The service that served this page, and the API key that it may require.
import { batch, computed, signal } from "@preact/signals";
import { Oviduct, OviductConnectionError, OviductError } from "oviduct-client";

/** The folder of this page, which is the URL of the service including the prefix of a proxy. */
export const base = new URL(".", document.baseURI);
// `fetch` refuses URLs with credentials; browsers send the credentials of the page themselves.
[base.username, base.password] = ["", ""];

const STORED = "oviduct-key";

/** The API key of this session, kept in the tab. */
export const key = signal(stored());
/** Reason why an API key is required; undefined while requests are accepted. */
export const locked = signal<"missing" | "refused" | undefined>(undefined);
/** Increases when another API key is used, because pages have read another owner's data. */
export const session = signal(0);
export const service = computed(() => new Oviduct(base, { key: key.value, fetch: direct, attempts: 3, maxDelay: 5000 }));

/**
 * Reads files from the service itself, because the page's policy forbids redirects to the artifact
 * store.
 */
function direct(input: RequestInfo | URL, init: RequestInit = {}): Promise<Response> {
  const headers = new Headers(init.headers);
  if (String(input).includes("/files/")) headers.set("prefer", "redirect=no");
  return fetch(input, { ...init, headers });
}

function stored(): string | undefined {
  try {
    return sessionStorage.getItem(STORED) ?? undefined;
  } catch {
    return undefined;
  }
}

/** Sets the API key for later requests; undefined removes it. */
export function setKey(value: string | undefined): void {
  try {
    if (value === undefined) sessionStorage.removeItem(STORED);
    else sessionStorage.setItem(STORED, value);
  } catch {
    // Storage is blocked; the key lasts until the page is left.
  }
  batch(() => {
    locked.value = undefined;
    key.value = value;
    session.value++;
  });
}

/** Calls the service. If the service requires an API key, the page asks for it. */
export async function ask<T>(call: (service: Oviduct) => Promise<T>): Promise<T> {
  try {
    return await call(service.value);
  } catch (error) {
    noteRefusal(error);
    throw error;
  }
}

export function noteRefusal(error: unknown): void {
  if (error instanceof OviductError && error.is("unauthorized")) {
    locked.value = key.value === undefined ? "missing" : "refused";
  }
}

const UNREACHABLE = "The service cannot be reached. Is it running?";
const UNUSABLE = "The answer of the service did not come in time, or is damaged. Try again.";

/** An error in words for users. */
export function explain(error: unknown): string {
  if (error instanceof OviductError) {
    // The response of a proxy whose service is not running.
    if (error.type === "about:blank" && error.status >= 502) return UNREACHABLE;
    if (error.is("forbidden")) return `This key does not allow that. ${error.detail}`;
    return error.errors.length > 0 ? error.errors.map((fault) => fault.detail).join(" ") : error.detail;
  }
  // A failed connection gives a TypeError; other causes are late, aborted or invalid responses.
  if (error instanceof OviductConnectionError) return error.cause instanceof TypeError ? UNREACHABLE : UNUSABLE;
  return error instanceof Error ? error.message : String(error);
}
