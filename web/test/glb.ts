// Binary glTF files for tests.

/** A file of a JSON description and binary data, which `write` writes at the offset `at`. */
export function glb(json: object, length: number, write: (view: DataView, at: number) => void): ArrayBuffer {
  let text = JSON.stringify(json);
  text += " ".repeat((4 - (text.length % 4)) % 4);
  const file = new ArrayBuffer(28 + text.length + length);
  const view = new DataView(file);
  [0x46546c67, 2, file.byteLength, text.length, 0x4e4f534a].forEach((word, i) => view.setUint32(4 * i, word, true));
  new Uint8Array(file, 20).set(new TextEncoder().encode(text));
  const at = 20 + text.length;
  view.setUint32(at, length, true);
  view.setUint32(at + 4, 0x004e4942, true);
  write(view, at + 8);
  return file;
}
