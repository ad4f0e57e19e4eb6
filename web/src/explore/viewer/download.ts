import { OviductConnectionError } from "oviduct-client";
import { ask } from "../../service.ts";

/** Downloads a file; `onProgress` gets the number of bytes so far. Throws as the client does. */
export async function download(
  id: string,
  name: string,
  onProgress: (bytes: number) => void,
  signal: AbortSignal,
): Promise<ArrayBuffer> {
  const response = await ask((service) => service.file(id, name, { signal }));
  // Safari cannot iterate over a stream.
  const reader = response.body!.getReader();
  const chunks: Uint8Array<ArrayBuffer>[] = [];
  let received = 0;
  try {
    for (let next = await reader.read(); !next.done; next = await reader.read()) {
      chunks.push(next.value);
      received += next.value.length;
      onProgress(received);
    }
  } catch (cause) {
    signal.throwIfAborted();
    throw new OviductConnectionError(`the download of ${name} broke off`, { cause });
  }
  return new Blob(chunks).arrayBuffer();
}
