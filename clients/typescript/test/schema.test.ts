// The client calls every operation of openapi.yaml, except those below.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

const UNUSED = ["get_docs", "get_openapi", "get_metrics"];

test("every operation has a method", () => {
  const at = (path: string) => readFileSync(new URL(`../${path}`, import.meta.url), "utf8");
  // The paths in the client, such as `models/{}/cancel`.
  const roots = "models|batches|fits|operations|workers|presets|schema|tickets|healthz|readyz|events";
  const client = at("src/client.ts").matchAll(new RegExp(`["\`]((?:${roots})[^"\`]*)["\`]`, "g"));
  const called = new Set(Array.from(client, ([, path]) => path!.replaceAll(/\$\{[^}]*\}/g, "{}")));
  const paths = at("src/schema.ts").matchAll(/^    "\/(.*)": \{$([^]*?)^    \};$/gm);
  let count = 0;
  for (const [, path, methods] of paths) {
    for (const [, operation] of methods!.matchAll(/operations\["(.*)"\]/g)) {
      count++;
      const isCalled = called.has(path!.replaceAll(/\{[^}]*\}/g, "{}"));
      assert.equal(isCalled, !UNUSED.includes(operation!), operation);
    }
  }
  assert(count > 35, String(count));
});
