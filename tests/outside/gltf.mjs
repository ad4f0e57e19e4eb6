// Judges .glb and .gltf files with the Khronos validator: any error or warning is a failure. The
// validator does not look into compressed data. A compressed file is therefore judged twice:
// unchanged, and as decoded by meshoptimizer.
// For each compressed FILE.glb, FILE.decoded.glb is kept for other judges.
// Usage: node gltf.mjs <folder that contains node_modules> <file>…
import { readFile, writeFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { dirname, resolve } from "node:path";

const [home, ...files] = process.argv.slice(2);
const require = createRequire(resolve(home, "package.json"));
const validator = require("gltf-validator");
const { MeshoptDecoder } = require("meshoptimizer");
if (files.length === 0) throw new Error("no files to judge");

const COMPRESSION = "EXT_meshopt_compression";
let bad = 0;

async function judge(file, bytes) {
  // The validator reports every extension that it does not know.
  const ignoredIssues = ["UNSUPPORTED_EXTENSION"];
  const format = isText(file) ? "gltf" : "glb";
  const externalResourceFunction = async (uri) => new Uint8Array(await readFile(resolve(dirname(file), uri)));
  const options = { uri: file, format, maxIssues: 20, ignoredIssues, externalResourceFunction };
  const { issues, info } = await validator.validateBytes(bytes, options);
  console.log(
    `gltf-validator: ${file}: ${issues.numErrors} errors, ${issues.numWarnings} warnings, ` +
      `${info.totalVertexCount} vertices, ${info.totalTriangleCount} triangles`,
  );
  if (issues.numErrors > 0 || issues.numWarnings > 0 || !(info.totalTriangleCount > 0)) {
    bad += 1;
    for (const { severity, code, message, pointer } of issues.messages) {
      if (severity < 2) console.log(`  ${code} at ${pointer}: ${message}`);
    }
  }
}

function isText(file) {
  return file.endsWith(".gltf");
}

function chunks(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  const length = view.getUint32(12, true);
  const json = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + length)));
  return { json, data: bytes.subarray(28 + length, 28 + length + view.getUint32(20 + length, true)) };
}

// The same document with decoded data of its buffer views, otherwise unchanged.
function decode({ json, data }) {
  const plain = new Uint8Array(json.buffers[1].byteLength);
  for (const view of json.bufferViews) {
    const { byteOffset, byteLength, byteStride, count, mode, filter } = view.extensions[COMPRESSION];
    const target = plain.subarray(view.byteOffset, view.byteOffset + view.byteLength);
    MeshoptDecoder.decodeGltfBuffer(target, count, byteStride, data.subarray(byteOffset, byteOffset + byteLength), mode, filter);
    delete view.extensions;
    view.buffer = 0;
  }
  json.buffers = [{ byteLength: plain.length }];
  json.extensionsUsed = json.extensionsUsed.filter((name) => name !== COMPRESSION);
  json.extensionsRequired = json.extensionsRequired.filter((name) => name !== COMPRESSION);
  let text = JSON.stringify(json);
  text = text.padEnd(Math.ceil(text.length / 4) * 4);
  const document = new TextEncoder().encode(text);
  const glb = new Uint8Array(28 + document.length + plain.length);
  const words = new DataView(glb.buffer);
  [0x46546c67, 2, glb.length, document.length, 0x4e4f534a].forEach((word, i) => words.setUint32(4 * i, word, true));
  glb.set(document, 20);
  words.setUint32(20 + document.length, plain.length, true);
  words.setUint32(24 + document.length, 0x004e4942, true);
  glb.set(plain, 28 + document.length);
  return glb;
}

await MeshoptDecoder.ready;
for (const file of files) {
  const bytes = new Uint8Array(await readFile(file));
  await judge(file, bytes);
  if (isText(file)) continue;
  const parts = chunks(bytes);
  if (parts.json.extensionsRequired?.includes(COMPRESSION)) {
    const decoded = decode(parts);
    const name = file.replace(/\.glb$/, ".decoded.glb");
    await writeFile(name, decoded);
    await judge(name, decoded);
  }
}
process.exit(bad > 0 ? 1 : 0);
