// Sends the request of the form, once.
import { computed, signal } from "@preact/signals";
import { OviductError } from "oviduct-client";
import { remember } from "../models.ts";
import { go } from "../router.ts";
import { ask, explain } from "../service.ts";
import { duration } from "../ui/format.ts";
import { faultsOf, opinion } from "./check.ts";
import type { Request } from "./form.ts";
import { request } from "./state.ts";

const STORED = "oviduct-request-attempt";

export const sending = signal(false);
const refused = signal<{ request: Request; reason: string } | undefined>(undefined);
/** Reason why the current request was refused, unless it is the fault of a field. */
export const refusal = computed(() => (refused.value?.request === request.value ? refused.value?.reason : undefined));

/**
 * Idempotency key of a request. It stays the same until there is a response, even after a reload.
 */
function keyOf(body: string): string {
  try {
    const [earlier, key] = JSON.parse(sessionStorage.getItem(STORED) ?? "[]") as [string?, string?];
    if (earlier === body && key !== undefined) return key;
    const fresh = randomKey();
    sessionStorage.setItem(STORED, JSON.stringify([body, fresh]));
    return fresh;
  } catch {
    return randomKey();
  }
}

function randomKey(): string {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (byte) => byte.toString(16).padStart(2, "0")).join("");
}

function forgetKey(): void {
  try {
    sessionStorage.removeItem(STORED);
  } catch {
    // The storage is blocked, so nothing was stored.
  }
}

/** Submits the request and shows the result; returns true if the service accepted it. */
export async function submit(): Promise<boolean> {
  const present = request.value;
  if (sending.value || present === undefined || Array.isArray(present)) return false;
  sending.value = true;
  refused.value = undefined;
  const idempotencyKey = keyOf(JSON.stringify(present));
  try {
    if (present.purpose === "model") {
      const model = await ask((service) => service.submit(present.body, { idempotencyKey }));
      remember([model]);
      go(["models", model.id]);
    } else {
      const { id } = await ask((service) => service.submitBatch(present.body, { idempotencyKey }));
      go(["batches", id]);
    }
    forgetKey();
    return true;
  } catch (error) {
    const faults = faultsOf(error);
    if (faults) opinion.value = { kind: "faults", faults };
    else refused.value = { request: present, reason: words(error) };
    if (answered(error)) forgetKey();
    return false;
  } finally {
    sending.value = false;
  }
}

/** True if the service refused. Without its response, the request may have been accepted. */
function answered(error: unknown): error is OviductError {
  return error instanceof OviductError && error.type !== "about:blank";
}

function words(error: unknown): string {
  if (!answered(error)) return `${explain(error)} Try again: the request is not made twice.`;
  if (error.retryAfter === undefined) return explain(error);
  return `${explain(error).replace(/ Try again later\.$/, "")} Try again in ${duration(error.retryAfter)}.`;
}
