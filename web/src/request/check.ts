// Validation of the form by the service while it is filled in: faults and predicted cost.
import { computed, effect, signal } from "@preact/signals";
import { OviductError, type BatchValidation, type Fault, type Validation } from "oviduct-client";
import { reconnections } from "../stream.ts";
import { ask, explain, session } from "../service.ts";
import { assign } from "./faults.ts";
import type { Request } from "./form.ts";
import { fields, localFaults, request } from "./state.ts";

export type Opinion =
  | { kind: "model"; validation: Validation }
  | { kind: "study"; validation: BatchValidation }
  | { kind: "faults"; faults: readonly Fault[] }
  /** There is no validation; `reason` explains why. */
  | { kind: "unknown"; reason: string };

/** Milliseconds without typing after which the form is validated. */
const PAUSE = 300;

/** The newest result; while `checking`, it may refer to an earlier state of the form. */
export const opinion = signal<Opinion | undefined>(undefined);
export const checking = signal(false);

export const faults = computed(() => {
  const found = localFaults() ?? (opinion.value?.kind === "faults" ? opinion.value.faults : []);
  return assign(found, fields.value);
});

/** The faults in an error response; undefined for other errors. */
export function faultsOf(error: unknown): readonly Fault[] | undefined {
  if (!(error instanceof OviductError) || error.status !== 422) return undefined;
  return error.errors.length > 0 ? error.errors : [{ pointer: "", detail: error.detail }];
}

async function validate(request: Request, signal: AbortSignal): Promise<Opinion> {
  try {
    return request.purpose === "model"
      ? { kind: "model", validation: await ask((service) => service.validate(request.body, { signal })) }
      : { kind: "study", validation: await ask((service) => service.validateBatch(request.body, { signal })) };
  } catch (error) {
    const faults = faultsOf(error);
    return faults ? { kind: "faults", faults } : { kind: "unknown", reason: explain(error) };
  }
}

/**
 * Validates each state of the form, always the newest one, until the returned function is called.
 */
export function checkWhileTyping(): () => void {
  let abort = new AbortController();
  let last = "";
  const stop = effect(() => {
    const present = request.value;
    const about = JSON.stringify([present, reconnections.value, session.value]);
    if (about === last) return;
    last = about;
    abort.abort();
    abort = new AbortController();
    const { signal } = abort;
    checking.value = present !== undefined && !Array.isArray(present);
    if (present === undefined || Array.isArray(present)) return;
    setTimeout(async () => {
      if (signal.aborted) return;
      const answer = await validate(present, signal);
      if (signal.aborted) return;
      opinion.value = answer;
      checking.value = false;
    }, PAUSE);
  });
  return () => {
    stop();
    abort.abort();
  };
}
