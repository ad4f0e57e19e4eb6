import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { subjectOf } from "../src/explore/files.ts";

/** Names in the first column of the table in docs/files.md. */
function documented(): string[] {
  const text = readFileSync("../docs/files.md", "utf8");
  const table = text.slice(0, text.indexOf("\n\n", text.indexOf("|---")));
  return table.split("\n").filter((line) => line.startsWith("| `")).flatMap((line) => [...line.split("|")[1]!.matchAll(/`([^`]+)`/g)].map((match) => match[1]!));
}

test("every documented file says what it holds", () => {
  const names = documented().filter((name) => name !== "manifest.json");
  assert.ok(names.includes("model.glb") && names.includes("frames.bin"));
  for (const name of [...names, "lumen.vtp", "regions.bin"]) assert.ok(subjectOf(name), name);
  assert.equal(subjectOf("lumen.ascii.stl"), "Surface of the lumen, STL as text");
});

test("other files do not", () => {
  for (const name of ["", "model", "model.exe", "other.glb", "constructor.glb", "model.lod9.glb", "toString"]) assert.equal(subjectOf(name), undefined);
});
