// Generates src/schema.ts from openapi.yaml. With --check, fails if the file is outdated.
import openapiTS, { astToString, COMMENT_HEADER } from "openapi-typescript";
import { createHash } from "node:crypto";
import { readFile, writeFile } from "node:fs/promises";

const source = new URL("../../../openapi.yaml", import.meta.url);
const target = new URL("../src/schema.ts", import.meta.url);

const types = await openapiTS(source, {
  // A default does not make a member of a request required.
  defaultNonNullable: false,
  emptyObjectsUnknown: true,
  transform(schema) {
    // Alternatives that only list required members would turn the whole type into `unknown`.
    const isCondition = (one) => Object.keys(one).join() === "required";
    if (schema.anyOf?.every(isCondition)) delete schema.anyOf;
    return undefined;
  },
});
// tests/whole/openapi.rs compares this digest, so it finds an outdated file without Node.
const digest = createHash("sha256").update(await readFile(source)).digest("hex");
const text = `${COMMENT_HEADER}// openapi.yaml: sha256 ${digest}\n\n${astToString(types)}`;

if (!process.argv.includes("--check")) {
  await writeFile(target, text);
} else if ((await readFile(target, "utf8")) !== text) {
  console.error("src/schema.ts is not that of openapi.yaml: run `npm run generate` in clients/typescript");
  process.exitCode = 1;
}
