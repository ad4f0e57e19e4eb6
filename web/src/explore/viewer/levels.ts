// Levels of detail: which files a model has, and which one this device should show.
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

/** The levels of a model, the lightest first. A model from before they existed has the whole surface only. */
export function levelsOf(model: Pick<Model, "files">): Level[] {
  const find = (name: string) => model.files.find((file) => file.name === name);
  const levels = FILES.flatMap(([name, title]) => {
    const file = find(name);
    return file ? [{ title, file }] : [];
  });
  const whole = find("model.glb");
  return levels.length > 0 || !whole ? levels : [{ title: "Full", file: whole }];
}

/** The best level that is loaded without being asked for: an index of `levels`. */
export function automaticLevel(levels: readonly Level[], { strength, saveData }: Device): number {
  const best = saveData ? 0 : { software: 0, ordinary: 1, strong: 2 }[strength];
  return Math.min(levels.length - 1, best);
}
