// The service of the page, at a URL with the credentials of a proxy.
import assert from "node:assert/strict";
import { test } from "node:test";
import { OviductConnectionError } from "oviduct-client";

Object.assign(globalThis, { document: { baseURI: "https://user:secret@lab.example/oviduct/index.html" } });
const { base, explain, service } = await import("../src/service.ts");

test("requests are sent to the folder of the page, without its credentials", () => {
  assert.equal(base.href, "https://lab.example/oviduct/");
  assert.equal(service.value.url, "https://lab.example/oviduct/");
});

test("only a connection that failed counts as a service that cannot be reached", () => {
  const words = (cause?: unknown) => explain(new OviductConnectionError("GET /models: …", { cause }));
  assert.match(words(new TypeError("Failed to fetch")), /cannot be reached/);
  assert.match(words(new SyntaxError("Unexpected token <")), /damaged/);
  assert.match(words(), /did not come in time/);
});
