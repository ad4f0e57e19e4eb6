// Event streams that break.
import assert from "node:assert/strict";
import { test } from "node:test";
import { Oviduct, OviductConnectionError, OviductError, type ModelEvent } from "oviduct-client";
// The package does not export these.
import { LIMITS, openEventSource } from "../dist/events.js";
import { ENDLESS, ENDLESS_FIT, FIT, SMALL, withServer, withService } from "./service.js";

test("a stream goes on through a restart of the service", async () => {
  await withService([], async (service) => {
    const key = await service.key();
    const client = new Oviduct(service.url, { key });
    const { id } = await client.submit({ ...ENDLESS, seed: 1 });
    const batch = await client.submitBatch({ ...SMALL, seeds: [1, 2] });
    const ended = client.waitBatch(batch.id);
    const events: ModelEvent[] = [];
    let restarted: Promise<void> | undefined;
    let before = 0;
    for await (const event of client.follow(id)) {
      events.push(event);
      if (event.type === "progress" && !restarted) {
        before = events.length;
        restarted = service.kill().then(() => service.start());
      } else if (event.type === "progress" && "attempts" in event.model && event.model.attempts > 1) {
        await client.cancel(id);
      }
    }
    await restarted;
    assert(events.slice(before).some((event) => event.type === "progress"), "progress after the restart");
    const last = events.at(-1);
    assert(last?.type === "end" && last.model.status === "cancelled");
    assert(last.model.attempts >= 2, "it was grown again after the restart");
    assert.equal((await ended).counts.succeeded, 2);
  });
});

test("the stream of a fit goes on through a restart of the service", async () => {
  await withService([], async (service) => {
    const client = new Oviduct(service.url, { key: await service.key() });
    const { id } = await client.submitFit(ENDLESS_FIT);
    const small = await client.submitFit(FIT);
    const ended = client.waitFit(small.id);
    let restarted: Promise<void> | undefined;
    let cancelled: Promise<unknown> | undefined;
    const done = await client.waitFit(id, {
      onProgress: (fit) => {
        if (!fit.progress?.evaluations) return;
        restarted ??= service.kill().then(() => service.start());
        if (fit.attempts > 1) cancelled ??= client.cancelFit(id);
      },
    });
    await Promise.all([restarted, cancelled]);
    assert.deepEqual([done.status, done.attempts], ["cancelled", 2]);
    assert.equal((await ended).status, "succeeded");
  });
});

test("a request waits for a service that is being restarted", async () => {
  await withService([], async (service) => {
    await service.kill();
    const submitted = new Oviduct(service.url).submit({ ...SMALL, seed: 1 });
    await service.start();
    assert.equal((await submitted).seed, 1);
  });
});

const END = 'event: end\nid: 3\ndata: {"id":"m","status":"succeeded","files":[{"href":"../m/files/model.glb"}]}\n\n';

test("a stream is resumed after the last event, with all its parameters", async () => {
  const asked: string[] = [];
  await withServer(
    (request, answer) => {
      asked.push(request.url ?? "");
      if (asked.length === 2) return void request.socket.destroy();
      if (asked.length === 3) {
        const headers = { "content-type": "application/problem+json", "retry-after": "1" };
        return void answer.writeHead(503, headers).end('{"type":"urn:oviduct:problem:too-many-streams"}');
      }
      answer.writeHead(200, { "content-type": "text/event-stream" });
      // All kinds of line ends, split into chunks; a comment, an id alone, and an incomplete event.
      const pieces = [
        ": hi\r",
        '\nevent: status\r\nid: 1\r\ndata: {"id":\r\ndata: "m","status":"running"}\r\n\r\nid: 2\r\r',
        "event: end\ndata: {",
      ];
      if (asked.length > 3) return void answer.end(END);
      const next = () => {
        const piece = pieces.shift();
        if (piece === undefined) return void answer.destroy();
        answer.write(piece, () => setTimeout(next, 30));
      };
      next();
    },
    async (url) => {
      const events = [];
      for await (const event of new Oviduct(url).follow("m", { view: "full" })) events.push(event);
      assert.deepEqual(events.map((event) => [event.type, event.id]), [["status", "1"], ["end", "3"]]);
      assert.deepEqual(events[0]?.model, { id: "m", status: "running" });
      assert.equal((events[1]?.model as { files: { href: string }[] }).files[0]?.href, `${url}/models/m/files/model.glb`);
      assert.deepEqual(asked, [
        "/models/m/events?view=full",
        ...Array<string>(3).fill("/models/m/events?view=full&last_event_id=2"),
      ]);
    },
  );
});

test("a stream without an event is begun anew with what has ended meanwhile", async () => {
  const asked: string[] = [];
  await withServer(
    (request, answer) => {
      asked.push(request.url ?? "");
      if (asked.length === 1) return void answer.writeHead(200, { "content-type": "text/event-stream" }).end();
      answer.writeHead(204).end();
    },
    async (url) => {
      for await (const event of new Oviduct(url).follow({ labels: { a: "b:c", d: "e" } })) assert.fail(event.type);
      const query = "label=a%3Ab%3Ac&label=d%3Ae";
      assert.deepEqual(asked, [`/events?${query}`, `/events?${query}&last_event_id=none`]);
    },
  );
});

test("a stream that cannot be opened fails", async () => {
  const follow = async (client: Oviduct) => {
    for await (const event of client.follow("m")) assert.fail(event.type);
  };
  await withServer(
    (_, answer) => answer.writeHead(404, { "content-type": "application/problem+json" }).end('{"title":"T"}'),
    (url) => assert.rejects(follow(new Oviduct(url)), OviductError),
  );
  const nobody = new Oviduct("http://127.0.0.1:9", { reconnects: 1 });
  await assert.rejects(follow(nobody), OviductConnectionError);
});

/** An EventSource that a test controls. */
class Scripted {
  static urls: string[] = [];
  static script: ((source: Scripted) => void)[] = [];
  readonly #listeners = new Map<string, (event: never) => void>();
  closed = false;
  constructor(url: string) {
    Scripted.urls.push(url);
    const act = Scripted.script.shift();
    setTimeout(() => act?.(this));
  }
  addEventListener(type: string, listener: (event: never) => void): void {
    this.#listeners.set(type, listener);
  }
  close(): void {
    this.closed = true;
  }
  send(type: string, data?: string, lastEventId = ""): void {
    this.#listeners.get(type)?.({ data, lastEventId } as never);
  }
}

/** Shortens the limits of streams during a test. */
async function withLimits(limits: Partial<typeof LIMITS>, test: () => Promise<void>): Promise<void> {
  const before = { ...LIMITS };
  Object.assign(LIMITS, limits);
  try {
    await test();
  } finally {
    Object.assign(LIMITS, before);
  }
}

test("a service that takes connections and never answers is given up", async () => {
  let requests = 0;
  await withServer(
    () => void requests++,
    (url) =>
      withLimits({ lasting: 20 }, async () => {
        for (const eventSource of [null, Scripted]) {
          [requests, Scripted.urls, Scripted.script] = [0, [], []];
          const client = new Oviduct(url, { eventSource, timeout: 100, reconnects: 2, maxDelay: 10 });
          await assert.rejects(client.wait("m", { signal: AbortSignal.timeout(3000) }), OviductConnectionError);
          assert.deepEqual([requests, Scripted.urls.length], eventSource ? [0, 3] : [3, 0]);
        }
      }),
  );
});

test("streams that last are opened again without end, also if they bring no event", async () => {
  let requests = 0;
  await withServer(
    (_, answer) => {
      answer.writeHead(200, { "content-type": "text/event-stream" });
      if (++requests > 4) return void answer.end(END);
      answer.write(":\n\n");
      setTimeout(() => answer.destroy(), 100);
    },
    (url) =>
      withLimits({ lasting: 20 }, async () => {
        const types = [];
        const client = new Oviduct(url, { reconnects: 1, maxDelay: 10 });
        for await (const event of client.follow("m")) types.push(event.type);
        assert.deepEqual([types, requests], [["end"], 5]);
      }),
  );
});

test("each EventSource has a ticket of its own, and is closed before the next", async () => {
  let tickets = 0;
  const posted: string[] = [];
  await withServer(
    (request, answer) => {
      posted.push(`${request.method} ${request.url}`);
      assert.equal(request.headers.authorization, "Bearer secret");
      if (request.method === "GET") return void answer.writeHead(204).end();
      answer.writeHead(201, { "content-type": "application/json" }).end(`{"ticket":"ovt_${++tickets}"}`);
    },
    async (url) => {
      const used: Scripted[] = [];
      Scripted.urls = [];
      Scripted.script = [
        (source) => {
          used.push(source);
          source.send("open");
          // The reader is slow, so it sees only the last of the two progress events.
          source.send("status", '{"id":"m","status":"running"}', "c-1");
          source.send("progress", '{"id":"m","status":"running","version":2}', "c-2");
          source.send("progress", '{"id":"m","status":"running","version":3}', "c-3");
          source.send("error");
        },
        (source) => {
          used.push(source);
          source.send("error");
        },
      ];
      const client = new Oviduct(url, { key: "secret", eventSource: Scripted });
      const events = [];
      for await (const event of client.follow({ labels: { of: "b" } })) events.push(event);
      assert.deepEqual(events.map((event) => event.id), ["c-1", "c-3"]);
      assert.deepEqual(Scripted.urls, [
        `${url}/events?label=of%3Ab&ticket=ovt_1`,
        `${url}/events?label=of%3Ab&last_event_id=c-3&ticket=ovt_2`,
      ]);
      assert(used.every((source) => source.closed));
      assert.deepEqual(posted, ["POST /tickets", "POST /tickets", "GET /events?label=of%3Ab&last_event_id=c-3"]);
    },
  );
});

test("the end of a batch is learnt by fetch, which sees ids without an event", async () => {
  const asked: string[] = [];
  await withServer(
    (request, answer) => {
      asked.push(request.url ?? "");
      if (asked.length > 1) return void answer.writeHead(204).end();
      // Another process of the service does not know the cursor.
      answer.writeHead(200, { "content-type": "text/event-stream" });
      answer.end('event: end\ndata: {"id":"m","status":"succeeded"}\nid: d-7\n\nid: over-b-1\n\n');
    },
    async (url) => {
      Scripted.urls = [];
      Scripted.script = [
        (source) => {
          source.send("open");
          source.send("end", '{"id":"m","status":"succeeded"}', "c-1");
          source.send("error");
        },
      ];
      const client = new Oviduct(url, { eventSource: Scripted });
      const ids = [];
      for await (const event of client.follow({ batch: "b" })) ids.push(event.id);
      assert.deepEqual(ids, ["c-1", "d-7"]);
      assert.deepEqual(Scripted.urls, [`${url}/events?batch=b`]);
      assert.deepEqual(asked, ["/events?batch=b&last_event_id=c-1", "/events?batch=b&last_event_id=over-b-1"]);
    },
  );
});

test("an EventSource that does not open or is quiet for too long gives way to another", async () => {
  let tickets = 0;
  await withServer(
    (request, answer) => {
      assert.equal(`${request.method} ${request.url}`, "POST /tickets");
      answer.writeHead(201, { "content-type": "application/json" }).end(`{"ticket":"ovt_${++tickets}"}`);
    },
    (url) =>
      withLimits({ quiet: 100 }, async () => {
        const used: Scripted[] = [];
        Scripted.urls = [];
        Scripted.script = [
          (source) => {
            used.push(source);
            source.send("open");
            source.send("status", '{"id":"m","status":"running"}', "c-1");
          },
          (source) => used.push(source),
          (source) => {
            used.push(source);
            source.send("open");
            source.send("end", '{"id":"m","status":"succeeded"}', "c-2");
          },
        ];
        const client = new Oviduct(url, { key: "secret", eventSource: Scripted, timeout: 300, maxDelay: 10 });
        const events = [];
        const signal = AbortSignal.timeout(5000);
        for await (const event of client.follow("m", { signal })) events.push(event.id);
        assert.deepEqual(events, ["c-1", "c-2"]);
        assert.deepEqual(Scripted.urls, [
          `${url}/models/m/events?ticket=ovt_1`,
          `${url}/models/m/events?last_event_id=c-1&ticket=ovt_2`,
          `${url}/models/m/events?last_event_id=c-1&ticket=ovt_3`,
        ]);
        assert(used.every((source) => source.closed));
      }),
  );
});

test("an EventSource stays open while events come", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  let source!: Scripted;
  Scripted.script = [(own) => (source = own).send("open")];
  const opening = openEventSource(Scripted, "http://127.0.0.1", 60_000);
  context.mock.timers.tick(1);
  const events = (await opening)!;
  for (const id of ["c-1", "c-2"]) {
    context.mock.timers.tick(LIMITS.quiet - 1);
    source.send("progress", '{"id":"m","status":"running"}', id);
    assert.equal((await events.next()).value?.id, id);
  }
  assert(!source.closed);
  context.mock.timers.tick(LIMITS.quiet);
  assert(source.closed);
  assert((await events.next()).done);
});

test("where no EventSource can connect, fetch reads the stream", async () => {
  await withServer(
    (_, answer) => answer.writeHead(200, { "content-type": "text/event-stream" }).end(END),
    async (url) => {
      Scripted.script = [(source) => source.send("error")];
      const events = [];
      for await (const event of new Oviduct(url, { eventSource: Scripted }).follow("m")) events.push(event.type);
      assert.deepEqual(events, ["end"]);
    },
  );
});
