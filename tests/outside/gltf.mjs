// Judges .glb files with the Khronos validator: any error or warning is a failure.
// Usage: node gltf.mjs <folder that holds node_modules> <file>…
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { resolve } from "node:path";

const [home, ...files] = process.argv.slice(2);
const validator = createRequire(resolve(home, "package.json"))("gltf-validator");
if (files.length === 0) throw new Error("no files to judge");

let bad = 0;
for (const file of files) {
  const bytes = new Uint8Array(await readFile(file));
  const { issues, info } = await validator.validateBytes(bytes, { uri: file, format: "glb", maxIssues: 20 });
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
process.exit(bad > 0 ? 1 : 0);
