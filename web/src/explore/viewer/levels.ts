// Levels of detail: the available files of a model, and the suitable one for this device.
import type { Model, ModelFile } from "oviduct-client";
import type { Device } from "./device.ts";

export interface Level {
  title: string;
  file: ModelFile;
}

const FILES = [
  ["model.lod2.glb", "Light"],
  ["model.lod1.glb", "Medium"],
  ["model.lod0.glb", "Full"],
] as const;

/**
 * The levels of detail of a model, coarsest first. Models of old versions have only the whole
 * surface.
 */
export function levelsOf(model: Pick<Model, "files">): Level[] {
  const find = (name: string) => model.files.find((file) => file.name === name);
  const levels = FILES.flatMap(([name, title]) => {
    const file = find(name);
    return file ? [{ title, file }] : [];
  });
  const whole = find("model.glb");
  return levels.length > 0 || !whole ? levels : [{ title: "Full", file: whole }];
}

/** Index in `levels` of the finest level of detail that is loaded automatically. */
export function automaticLevel(levels: readonly Level[], { strength, saveData }: Device): number {
  const best = saveData ? 0 : { software: 0, ordinary: 1, strong: 2 }[strength];
  return Math.min(levels.length - 1, best);
}
