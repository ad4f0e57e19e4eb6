import { ask } from "../../service.ts";

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
