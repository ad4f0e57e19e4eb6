// The event stream of the page, without a service.
import assert from "node:assert/strict";
import { test } from "node:test";

const page = Object.assign(new EventTarget(), { baseURI: "http://lab.example/", hidden: false });
Object.assign(globalThis, { document: page, addEventListener: () => {} });
const { connection, watch } = await import("../src/stream.ts");
const { setKey } = await import("../src/service.ts");

/** Response of the service, and the API keys of received requests. */
let answer: { status: number; slug: string };
let asked: (string | null)[] = [];
globalThis.fetch = async (_, init) => {
  asked.push(new Headers(init?.headers).get("authorization"));
  const { status, slug } = answer;
  const problem = { type: `urn:oviduct:problem:${slug}`, title: "No", status, detail: "No." };
  return new Response(JSON.stringify(problem), { status, headers: { "content-type": "application/problem+json" } });
};

test("a key that may not read is not tried again, another one is", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout", "setInterval"] });
  const pass = async (seconds: number) => {
    for (let i = 0; i < seconds; i++) {
      context.mock.timers.tick(1000);
      for (let k = 0; k < 50; k++) await new Promise(setImmediate);
    }
  };
  answer = { status: 403, slug: "forbidden" };
  watch();
  await pass(60);
  assert.deepEqual(asked, [null]);
  assert.equal(connection.value, "refused");

  // The page was hidden and is visible again.
  for (const hidden of [true, false]) {
    page.hidden = hidden;
    page.dispatchEvent(new Event("visibilitychange"));
    await pass(60);
  }
  assert.deepEqual(asked, [null]);

  setKey("other");
  await pass(60);
  assert.deepEqual(asked, [null, "Bearer other"]);

  // Other refusals may be transient.
  answer = { status: 429, slug: "rate-limited" };
  asked = [];
  setKey("busy");
  await pass(60);
  assert(asked.length > 3, `${asked.length} requests`);
  assert.equal(connection.value, "lost");

  // The page asks for an API key.
  answer = { status: 401, slug: "unauthorized" };
  asked = [];
  setKey("wrong");
  await pass(60);
  assert.deepEqual(asked, ["Bearer wrong"]);
});
