// The state of the form, which is kept in the session, filled in from links, and read by all parts
// of the page.
import { batch, computed, effect, signal } from "@preact/signals";
import type { Fault, Preset, PresetList } from "oviduct-client";
import { ask, explain } from "../service.ts";
import { BLANK, RANGE, requestOf, variedOf, variedPointer, type Form } from "./form.ts";
import { parametersOf, type Parameter, type SchemaNode } from "./parameters.ts";
import { changesOf } from "./patch.ts";
import { same, type Value } from "./schedule.ts";

const STORED = "oviduct-request";

export interface Catalogue {
  schema: SchemaNode;
  presets: PresetList["presets"];
  details: ReadonlyMap<string, Preset>;
}

export const form = signal<Form>(stored());
export const catalogue = signal<Catalogue | undefined>(undefined);
/** Origin of the form's values, or the reason why they could not be loaded. */
export const origin = signal<{ id: string } | { failed: string } | undefined>(undefined);

const presetName = computed(() => {
  const presets = catalogue.value?.presets;
  const chosen = presets?.find(({ name }) => name === form.value.preset);
  return (chosen ?? presets?.find((preset) => preset.default) ?? presets?.[0])?.name;
});
export const preset = computed(() => catalogue.value?.details.get(presetName.value ?? ""));
export const parameters = computed<readonly Parameter[]>(() =>
  catalogue.value && preset.value ? parametersOf(catalogue.value.schema, preset.value) : [],
);
/** Titles of the parameters by pointer. */
export const titles = computed<ReadonlyMap<string, string>>(() => new Map(parameters.value.map(({ pointer, title }) => [pointer, title])));
/** The varied parameters that the current preset has. */
export const varied = computed(() => variedOf(form.value, parameters.value));
/** The request as it would be sent, or faults that the form itself detects. */
export const request = computed(() => preset.value && requestOf(form.value, preset.value.name, parameters.value));
/** Pointers of all fields that can show faults, roughly from top to bottom. */
export const fields = computed<readonly string[]>(() => [
  ...["/preset", "/seed", "/seeds", "/count"],
  ...varied.value.flatMap(({ pointer }) => [undefined, ...RANGE].map((member) => variedPointer(pointer, member))),
  "/vary/samples",
  ...parameters.value.map(({ pointer }) => `/spec${pointer}`),
  ...["/labels", "/outputs", "/bodies", "/units", "/backend", "/priority", "/reuse"],
]);

export function localFaults(): Fault[] | undefined {
  return Array.isArray(request.value) ? request.value : undefined;
}

function stored(): Form {
  try {
    // JSON has no NaN, so text that was not a number is null.
    const text = sessionStorage.getItem(STORED) ?? "{}";
    return { ...BLANK, ...(JSON.parse(text, (_, value: unknown) => (value === null ? NaN : value)) as Partial<Form>) };
  } catch {
    return BLANK;
  }
}

effect(() => {
  try {
    sessionStorage.setItem(STORED, JSON.stringify(form.value));
  } catch {
    // Storage is blocked or full; the form lasts until the page is left.
  }
});

/** The request for the model that a link names. It is aborted when the form changes otherwise. */
let filling: AbortController | undefined;

export function change(part: Partial<Form>): void {
  filling?.abort();
  form.value = { ...form.value, ...part };
}

/** Sets a parameter; the preset's value does not count as a change. */
export function setParameter({ pointer, preset }: Parameter, value: Value): void {
  const { [pointer]: _, ...others } = form.value.changes;
  change({ changes: same(value, preset) ? others : { ...others, [pointer]: value } });
}

export function startOver(): void {
  filling?.abort();
  batch(() => {
    form.value = { ...BLANK, preset: form.value.preset, purpose: form.value.purpose };
    origin.value = undefined;
  });
}

export async function loadCatalogue(): Promise<void> {
  const [schema, { presets }] = await Promise.all([ask((service) => service.schema()), ask((service) => service.presets())]);
  const details = await Promise.all(presets.map(({ name }) => ask((service) => service.preset(name))));
  catalogue.value = { schema, presets, details: new Map(details.map((preset) => [preset.name, preset])) };
}

const noPreset = (name: string) => `This service has no preset “${name}”.`;

/**
 * Fills in a blank form as a link requests: with a preset, a seed, or the request of a model
 * (`from`).
 *
 * A link with only a `purpose` keeps the form.
 */
export async function fillFrom(query: URLSearchParams): Promise<void> {
  const { schema, details } = catalogue.value!;
  const [name, seed, from] = ["preset", "seed", "from"].map((member) => query.get(member) ?? undefined);
  const purpose = query.get("purpose") === "study" ? "study" : "model";
  if (name === undefined && seed === undefined && from === undefined) {
    if (query.has("purpose")) change({ purpose });
    return;
  }
  const filled: Form = { ...BLANK, preset: name, seed: seed ?? "", purpose };
  filling?.abort();
  filling = new AbortController();
  const { signal } = filling;
  if (from === undefined) {
    batch(() => {
      form.value = filled;
      origin.value = name === undefined || details.has(name) ? undefined : { failed: noPreset(name) };
    });
    return;
  }
  try {
    const model = await ask((service) => service.get(from, { signal }));
    if (signal.aborted) return;
    const base = details.get(model.preset);
    batch(() => {
      form.value = {
        ...filled,
        preset: model.preset,
        seed: seed ?? String(model.seed),
        changes: base ? changesOf(model.spec, parametersOf(schema, base)) : {},
        labels: Object.entries(model.labels).map(([name, value]) => ({ name, value })),
        outputs: model.outputs,
        bodies: model.bodies,
        units: model.units ?? "habit",
        backend: model.backend.requested,
        priority: String(model.priority),
      };
      origin.value = base ? { id: from } : { failed: noPreset(model.preset) };
    });
  } catch (error) {
    if (signal.aborted) return;
    batch(() => {
      form.value = filled;
      origin.value = { failed: `The model to start from could not be read. ${explain(error)}` };
    });
  }
}
