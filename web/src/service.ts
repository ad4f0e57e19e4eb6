// The service that served this page, and the key that it may ask for.
import { batch, computed, signal } from "@preact/signals";
import { Oviduct, OviductConnectionError, OviductError } from "oviduct-client";

/** The folder of this page: where the service is, with the prefix of a proxy. */
export const base = new URL(".", document.baseURI);
// `fetch` refuses addresses with credentials; browsers send those of the page by themselves.
[base.username, base.password] = ["", ""];

const STORED = "oviduct-key";

/** The key of this session, kept in the tab. */
export const key = signal(stored());
/** Why a key is asked for; undefined while requests are let in. */
export const locked = signal<"missing" | "refused" | undefined>(undefined);
/** Grows when another key is used: what pages have read is another owner's. */
export const session = signal(0);
export const service = computed(() => new Oviduct(base, { key: key.value, fetch: direct, attempts: 3, maxDelay: 5000 }));

/** Files are read from the service itself: the policy of the page does not let it follow a redirect to the artifact store. */
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

/** Uses a key from now on; undefined forgets it. */
export function setKey(value: string | undefined): void {
  try {
    if (value === undefined) sessionStorage.removeItem(STORED);
    else sessionStorage.setItem(STORED, value);
  } catch {
    // Storage is blocked: the key is kept until the page is left.
  }
  batch(() => {
    locked.value = undefined;
    key.value = value;
    session.value++;
  });
}

/** Calls the service. If it asks for a key, the page does too. */
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

/** An error in words for people. */
export function explain(error: unknown): string {
  if (error instanceof OviductError) {
    // A proxy in front of a service that does not run.
    if (error.type === "about:blank" && error.status >= 502) return UNREACHABLE;
    if (error.is("forbidden")) return `This key does not allow that. ${error.detail}`;
    return error.errors.length > 0 ? error.errors.map((fault) => fault.detail).join(" ") : error.detail;
  }
  // `fetch` fails with a TypeError if the connection does; the others are answers that are late, cut off or no JSON.
  if (error instanceof OviductConnectionError) return error.cause instanceof TypeError ? UNREACHABLE : UNUSABLE;
  return error instanceof Error ? error.message : String(error);
}
