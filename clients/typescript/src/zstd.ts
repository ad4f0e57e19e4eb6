import { decompress as decode } from "fzstd";

/**
 * Decodes a Zstandard frame of `size` bytes, which neither browsers nor Node 20 can do.
 *
 * The build bundles the library into this module, so the package has no dependencies.
 */
export function decompress(frame: Uint8Array, size: number): Uint8Array {
  let bytes: Uint8Array;
  try {
    bytes = decode(frame);
  } catch (cause) {
    throw new Error("the Zstandard frame is damaged", { cause });
  }
  if (bytes.length !== size) throw new Error(`the Zstandard frame is damaged: ${bytes.length} bytes instead of ${size}`);
  return bytes;
}
