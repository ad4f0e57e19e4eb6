// Compiles the code of docs/clients.md and runs it as one program.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { test } from "node:test";
import { fileURLToPath } from "node:url";
import { withService } from "./service.js";

const at = (path: string) => fileURLToPath(new URL(`../${path}`, import.meta.url));

test("the tutorial runs", async () => {
  const document = readFileSync(at("../../docs/clients.md"), "utf8");
  const section = /^## TypeScript$([^]*?)(?=^## |(?![^]))/m.exec(document)?.[1] ?? "";
  const blocks = Array.from(section.matchAll(/^```ts\n([^]*?)^```$/gm), ([, block]) => block!);
  assert(blocks.length >= 8, String(blocks.length));
  mkdirSync(at("build/docs"), { recursive: true });
  writeFileSync(at("build/docs/tutorial.ts"), blocks.join("\n"));
  const config = {
    extends: "../../tsconfig.json",
    // Compile like a user, without browser types; also check the declarations of the package.
    compilerOptions: { lib: ["ES2022"], types: ["node"], rootDir: ".", outDir: ".", declaration: false, skipLibCheck: false },
    files: ["tutorial.ts"],
    include: [],
  };
  writeFileSync(at("build/docs/tsconfig.json"), JSON.stringify(config));
  const run = (...line: string[]) => {
    try {
      return execFileSync(process.execPath, line, { encoding: "utf8" });
    } catch (error) {
      throw new Error(`${line.join(" ")}:\n${(error as { stdout: string }).stdout}`, { cause: error });
    }
  };
  run(at("node_modules/typescript/bin/tsc"), "--project", at("build/docs"));
  await withService([], async (service) => {
    process.env["OVIDUCT_URL"] = service.url;
    process.env["OVIDUCT_KEY"] = await service.key();
    const output = run(at("build/docs/tutorial.js"));
    for (const wanted of [
      /^running simulate /m,
      /^\d+ bytes of glTF$/m,
      /^\/spec\/collision\/gap_um is -3/m,
      /^end [0-9a-f-]{36} succeeded$/m,
      /^\d+ sections; the first is at 0 µm and has \d+ points, at /m,
      /^attachment; filename="pig-7-model.glb"$/m,
      /^[0-9a-f-]{36} 2\d{3}-/m,
      /^0 models would be deleted$/m,
      /^0\.2 \d+\n0\.3 \d+$/m,
      /^lumen_perimeter_mm [\d.]+ met$/m,
    ]) {
      assert.match(output, wanted);
    }
    assert(!output.includes("not reached"));
  });
});
