// Changes of a preset, as a merge patch (RFC 7396) and as values by JSON pointer.
import type { Parameter } from "./parameters.ts";
import { isSchedule, readValue, same, sameFluctuation, sameKeys, type Schedule, type Value } from "./schedule.ts";
import { readPoints } from "./text.ts";

/** Changed values by the pointers of their parameters. */
export type Changes = Readonly<Record<string, Value>>;

export interface Json {
  [name: string]: unknown;
}

/** The merge patch on the preset with these changes; empty if there are none. */
export function specPatch(changes: Changes, parameters: readonly Parameter[]): Json {
  const patch: Json = {};
  for (const { pointer, kind, preset } of parameters) {
    const value = changes[pointer];
    if (value === undefined || same(value, preset)) continue;
    const segments = pointer.split("/").slice(1);
    const last = segments.pop()!;
    let at = patch;
    for (const segment of segments) at = (at[segment] ??= {}) as Json;
    at[last] = kind.type === "points" ? readPoints(String(value), kind.coordinates) : isSchedule(value) ? schedulePatch(value, preset) : value;
  }
  return patch;
}

/**
 * The patch for a schedule.
 *
 * A patch keeps the members of the preset's schedule that it does not name; over a constant,
 * omitted members have their defaults.
 */
function schedulePatch(value: Schedule, preset: Value): Json {
  const below = isSchedule(preset) ? preset : undefined;
  const patch: Json = {};
  if (!below || !sameKeys(value, below)) patch["keys"] = value.keys;
  if (value.ease !== (below?.ease ?? "linear")) patch["ease"] = value.ease;
  if (!below || !sameFluctuation(value, below)) {
    // `null` would restore the fluctuation of the preset.
    if (value.fluctuation) patch["fluctuation"] = value.fluctuation;
    else if (below?.fluctuation) patch["fluctuation"] = { amplitude: 0 };
  }
  return patch;
}

/** The differences between a complete spec and the preset. */
export function changesOf(spec: unknown, parameters: readonly Parameter[]): Changes {
  const changes: Record<string, Value> = {};
  for (const { pointer, preset } of parameters) {
    const value = readValue(valueAt(spec, pointer));
    if (value !== undefined && !same(value, preset)) changes[pointer] = value;
  }
  return changes;
}

function valueAt(spec: unknown, pointer: string): unknown {
  let at = spec;
  for (const segment of pointer.split("/").slice(1)) {
    if (typeof at !== "object" || at === null) return undefined;
    at = (at as Json)[segment];
  }
  return at;
}
