// The names of the presets, read once per API key.
import { signal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import type { PresetList } from "oviduct-client";
import { ask, session } from "../service.ts";

const presets = signal<PresetList["presets"]>([]);
let readFor: number | undefined;

/** The presets of the service; none until they have been read. */
export function usePresets(): PresetList["presets"] {
  useEffect(() => {
    if (readFor === session.peek()) return;
    readFor = session.peek();
    ask((service) => service.presets()).then(
      (list) => (presets.value = list.presets),
      () => (readFor = undefined),
    );
  }, []);
  return presets.value;
}

/** `Pig oviduct` for `pig`, after the presets have been read. */
export function presetTitle(name: string): string {
  return presets.value.find((preset) => preset.name === name)?.title ?? name;
}
