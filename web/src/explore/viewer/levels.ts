// Levels of detail: which files a model has, which one this device should show, and their download.
import type { Model, ModelFile } from "oviduct-client";
import { ask } from "../../service.ts";

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

/** What is known of the device. */
export interface Device {
  /** Name of the graphics processor. */
  renderer: string;
  /** Gigabytes; browsers that do not tell count as weak. */
  memory: number;
  cores: number;
  saveData: boolean;
  touch: boolean;
}

export function deviceOf(renderer: string): Device {
  const browser = navigator as Navigator & { deviceMemory?: number; connection?: { saveData?: boolean } };
  return {
    renderer,
    memory: browser.deviceMemory ?? 0,
    cores: navigator.hardwareConcurrency,
    saveData: browser.connection?.saveData ?? false,
    touch: matchMedia("(pointer: coarse)").matches,
  };
}

/** The best level that is loaded without being asked for: an index of `levels`. */
export function automaticLevel(levels: readonly Level[], device: Device): number {
  const last = levels.length - 1;
  if (device.saveData || /swiftshader|llvmpipe|software|basic render/i.test(device.renderer)) return 0;
  const strong = device.memory >= 8 && device.cores >= 8 && !device.touch;
  return Math.min(last, strong ? 2 : 1);
}

/** Downloads a file; `onProgress` gets the number of bytes so far. Throws as the client does. */
export async function download(
  id: string,
  name: string,
  onProgress: (bytes: number) => void,
  signal: AbortSignal,
): Promise<ArrayBuffer> {
  const response = await ask((service) => service.file(id, name, { signal }));
  const chunks: Uint8Array<ArrayBuffer>[] = [];
  let received = 0;
  for await (const chunk of response.body ?? []) {
    chunks.push(chunk);
    received += chunk.length;
    onProgress(received);
  }
  return new Blob(chunks).arrayBuffer();
}
