// Retries, time limits and error messages, with servers that misbehave.
import assert from "node:assert/strict";
import { test } from "node:test";
import { setTimeout as sleep } from "node:timers/promises";
import { inspect } from "node:util";
import { gzipSync } from "node:zlib";
import { Oviduct, OviductConnectionError, OviductError, type OviductOptions } from "oviduct-client";
import { withServer } from "./service.js";

const KEY = "oviduct_0123abcd_verysecret";
const MODEL = '{"id":"m","status":"queued","files":[]}';

async function failure(call: Promise<unknown>): Promise<unknown> {
  return call.then(
    () => assert.fail("it succeeded"),
    (error: unknown) => error,
  );
}

test("a submission is repeated with the same key, also if the answer is lost", async () => {
  const keys: unknown[] = [];
  await withServer(
    (request, answer) => {
      keys.push(request.headers["idempotency-key"]);
      if (keys.length === 1) return void request.socket.destroy();
      if (keys.length === 2) return void answer.writeHead(503, { "retry-after": "1" }).end();
      if (keys.length === 3) {
        // The connection breaks within the body.
        answer.writeHead(202, { "content-length": "100" }).write("{");
        return void setTimeout(() => answer.destroy(), 20);
      }
      answer.writeHead(202).end(MODEL);
    },
    async (url) => {
      const client = new Oviduct(url);
      const began = Date.now();
      assert.equal((await client.submit({})).id, "m");
      assert(Date.now() - began >= 1000, "Retry-After");
      assert.equal(keys.length, 4);
      assert.match(String(keys[0]), /^[0-9a-f]{32}$/);
      assert.deepEqual(new Set(keys).size, 1);
      await client.submit({});
      assert.notEqual(keys[4], keys[0]);
    },
  );
});

test("attempts are bounded, and what cannot get better is not repeated", async () => {
  let count = 0;
  let status = 503;
  await withServer(
    (_, answer) => {
      count++;
      answer.writeHead(status, { "retry-after": status === 429 ? "3600" : "0" }).end("<html>");
    },
    async (url) => {
      const client = new Oviduct(url, { attempts: 3, maxDelay: 20 });
      const error = (await failure(client.presets())) as OviductError;
      assert.deepEqual([error.status, error.type, count], [503, "about:blank", 3]);
      for (const [code, attempts] of [[429, 1], [500, 1], [404, 1], [504, 3], [408, 3]] as const) {
        [status, count] = [code, 0];
        assert.equal(((await failure(client.presets())) as OviductError).status, code);
        assert.equal(count, attempts, String(code));
      }
      [status, count] = [503, 0];
      await failure(client.health());
      assert.equal(count, 1, "a probe is sent once");
    },
  );
});

test("a deletion whose answer was lost has succeeded", async () => {
  let count = 0;
  await withServer(
    (request, answer) => {
      if (++count === 1) request.socket.destroy();
      else answer.writeHead(404).end();
    },
    async (url) => {
      const client = new Oviduct(url);
      assert.equal(await client.delete("m"), undefined);
      assert.equal(((await failure(client.delete("m"))) as OviductError).status, 404);
    },
  );
});

test("a deletion that was only refused before has not succeeded", async () => {
  const statuses = [429, 502, 503, 404];
  await withServer(
    (_, answer) => answer.writeHead(statuses.shift() ?? 500).end(),
    async (url) => {
      const error = (await failure(new Oviduct(url, { maxDelay: 10 }).delete("m"))) as OviductError;
      assert.deepEqual([error.status, statuses], [404, []]);
    },
  );
});

test("a signal ends a request, a wait and a stream", async () => {
  await withServer(
    (request, answer) => {
      if (request.url === "/presets") answer.writeHead(503, { "retry-after": "20" }).end();
      if (request.url?.endsWith("/events")) answer.writeHead(200).write(":\n\n");
    },
    async (url) => {
      const client = new Oviduct(url);
      const calls = [
        (signal: AbortSignal) => client.schema({ signal }),
        (signal: AbortSignal) => client.presets({ signal }),
        (signal: AbortSignal) => client.wait("m", { signal }),
      ];
      for (const call of calls) {
        const began = Date.now();
        assert.equal(((await failure(call(AbortSignal.timeout(100)))) as Error).name, "TimeoutError");
        assert(Date.now() - began < 5000);
        assert.equal(await failure(call(AbortSignal.abort("before"))), "before");
      }
    },
  );
});

test("an answer that does not come or is no JSON is a failed connection", async () => {
  await withServer(
    (request, answer) => void (request.url === "/schema" && answer.end("<html>")),
    async (url) => {
      const client = new Oviduct(url, { timeout: 50, attempts: 2, maxDelay: 10 });
      const late = (await failure(client.presets())) as Error;
      assert(late instanceof OviductConnectionError);
      assert.match(late.message, /^GET http:\/\/127\.0\.0\.1:\d+\/presets: no answer within 50 ms$/);
      assert.match(((await failure(client.schema())) as Error).message, /the answer is not JSON/);
    },
  );
});

test("a body may take longer than the limit, but not pause for so long", async () => {
  let requests = 0;
  await withServer(
    async (request, answer) => {
      requests++;
      answer.writeHead(200).write("a");
      if (request.url?.startsWith("/models/silent")) return;
      for (let i = 0; i < 8; i++) await sleep(100).then(() => answer.write("a"));
      answer.end();
    },
    async (url) => {
      const client = new Oviduct(url, { timeout: 400, attempts: 2, maxDelay: 10 });
      const [bytes, csv] = await Promise.all([client.bytes("m", "f"), client.tableCsv("b")]);
      assert.deepEqual([Buffer.from(bytes).toString(), csv, requests], ["aaaaaaaaa", "aaaaaaaaa", 2]);
      requests = 0;
      const signal = AbortSignal.timeout(3000);
      const errors = await Promise.all([client.bytes("silent", "f", { signal }), client.get("silent", { signal })].map(failure));
      for (const error of errors) {
        assert(error instanceof OviductConnectionError);
        assert.match(String(error.cause), /nothing came for 400 ms/);
      }
      assert.equal(requests, 4);
      const patient = new Oviduct(url).bytes("silent", "f", { signal: AbortSignal.timeout(100) });
      assert.equal(((await failure(patient)) as Error).name, "TimeoutError");
    },
  );
});

test("bytes that do not have the hash of their entity tag are loaded again", async () => {
  const tag = '"5891b5b522d5df086d0ff0b110fbd9d21bb4fc7163af34d08286a2e846f6be03"';
  // The entity tag of a compressed response is weak.
  const weak = { etag: `W/${tag}`, "content-encoding": "gzip" };
  for (const headers of [{ etag: tag }, weak]) {
    let count = 0;
    await withServer(
      (_, answer) => {
        const text = ++count % 2 ? "hallo\n" : "hello\n";
        answer.writeHead(200, headers).end(headers === weak ? gzipSync(text) : text);
      },
      async (url) => {
        assert.equal(Buffer.from(await new Oviduct(url).bytes("m", "f")).toString(), "hello\n");
        assert((await failure(new Oviduct(url, { attempts: 1 }).bytes("m", "f"))) instanceof OviductConnectionError);
      },
    );
  }
});

test("the progress of bytes is told as they come, and begins anew with each attempt", async () => {
  // Each part is sent after the progress of the previous one was reported.
  let told = () => {};
  let attempts = 0;
  await withServer(
    async (_, answer) => {
      const parts = ++attempts === 1 ? ["ab"] : ["ab", "cde", "f"];
      answer.writeHead(200, { "content-length": "6" });
      for (const part of parts) {
        await new Promise<void>((resolve) => {
          told = resolve;
          answer.write(part);
        });
      }
      if (attempts === 1) answer.destroy();
      else answer.end();
    },
    async (url) => {
      const seen: number[] = [];
      const onProgress = (received: number) => {
        seen.push(received);
        told();
      };
      const bytes = await new Oviduct(url, { maxDelay: 10 }).bytes("m", "f", { onProgress });
      assert.equal(Buffer.from(bytes).toString(), "abcdef");
      assert.deepEqual(seen, [2, 2, 5, 6]);
    },
  );
});

test("of the faults of a problem only those that are well formed are taken", async () => {
  const fault = { pointer: "/a", detail: "D" };
  const others = [null, 1, "text", {}, { detail: 1 }, { pointer: { toString: 1, valueOf: 1 }, detail: "D" }];
  const cases: [errors: unknown, taken: unknown[]][] = [
    ["many", []],
    [{ "/a": ["D"] }, []],
    [null, []],
    [[...others, fault, { detail: "E" }], [fault, { detail: "E" }]],
  ];
  for (const [errors, taken] of cases) {
    await withServer(
      (_, answer) => {
        answer.writeHead(422, { "content-type": "application/problem+json" });
        answer.end(JSON.stringify({ type: "urn:oviduct:problem:invalid-request", title: "T", detail: "D", errors }));
      },
      async (url) => {
        const error = (await failure(new Oviduct(url, { attempts: 1 }).presets())) as OviductError;
        assert(error instanceof OviductError && error.is("invalid-request"), String(error));
        assert.deepEqual(error.errors, taken);
        assert.equal(error.message, taken.length > 0 ? "T: D\n- /a: D\n- E" : "T: D");
      },
    );
  }
});

test("nothing shows the key", async () => {
  await withServer(
    (request, answer) => {
      if (request.url === "/presets") answer.writeHead(401, { "content-type": "application/problem+json" });
      if (request.url === "/presets") return void answer.end('{"type":"urn:oviduct:problem:unauthorized","title":"T"}');
      request.socket.destroy();
    },
    async (url) => {
      const options: OviductOptions = { key: KEY, attempts: 1, reconnects: 0 };
      const client = new Oviduct(url, options);
      const unreachable = new Oviduct("http://127.0.0.1:9", options);
      const shown: unknown[] = [
        client,
        await failure(client.presets()),
        await failure(client.schema()),
        await failure(client.downloadUrl("m", "f")),
        await failure(client.wait("m")),
        await failure(unreachable.presets()),
        await failure(unreachable.get("m", { signal: AbortSignal.abort() })),
      ];
      for (const key of [`${KEY}\n`, `${KEY} `, `${KEY}\u00e9`, ""]) {
        assert.throws(
          () => new Oviduct(url, { key }),
          (error) => error instanceof TypeError && shown.push(error) > 0,
        );
      }
      assert.throws(
        () => new Oviduct(`http://name:${KEY}@127.0.0.1`),
        (error) => error instanceof TypeError && shown.push(error) > 0,
      );
      for (const one of shown) {
        const text = inspect(one, { depth: 20, showHidden: true }) + JSON.stringify(one) + String(one);
        assert(!text.includes("verysecret"), text);
      }
    },
  );
});
