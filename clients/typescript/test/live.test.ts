// Every method against a live service.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { after, before, test } from "node:test";
import { Oviduct, OviductError, type FitEvent, type Model, type ModelEvent, type Operation } from "oviduct-client";
import { ENDLESS, ENDLESS_FIT, FIT, proxy, Service, SMALL, withServer, withService } from "./service.js";

let service: Service;
let client: Oviduct;
let model: Model;

before(async () => {
  service = await Service.start();
  client = new Oviduct(service.url);
  model = await client.wait((await client.submit({ ...SMALL, seed: 1, labels: { study: "A:3" } })).id);
});
after(() => service[Symbol.asyncDispose]());

/** The problem with which a call fails. */
async function problemOf(call: Promise<unknown>): Promise<OviductError> {
  const error = await call.then(
    () => assert.fail("it succeeded"),
    (error: unknown) => error,
  );
  assert(error instanceof OviductError, String(error));
  return error;
}

async function all<T>(items: AsyncIterable<T>): Promise<T[]> {
  const found = [];
  for await (const item of items) found.push(item);
  return found;
}

test("a model is submitted, followed, waited for and deleted", async () => {
  const states: string[] = [];
  const submitted = await client.submit({ ...SMALL, seed: 2 });
  const done = await client.wait(submitted.id, { onProgress: (state) => states.push(state.status) });
  assert.equal(done.status, "succeeded");
  assert(done.spec, "the whole model");
  assert.equal(states.at(-1), "succeeded");
  const events = await all(client.follow(done.id));
  assert.deepEqual(events.map((event) => event.type), ["end"]);
  assert.equal((await client.get(done.id, { view: "summary" })).spec, undefined);
  await client.delete(done.id);
  assert((await problemOf(client.get(done.id))).is("model-not-found"));
  assert((await problemOf(client.wait(done.id))).is("model-not-found"));
});

test("the answer is held for a time, a finished model reused, and a key gives the same model again", async () => {
  const held = await client.submit({ ...SMALL, seed: 3 }, { wait: 60 });
  assert.equal(held.status, "succeeded");
  assert.equal((await client.submit({ ...SMALL, seed: 3 })).reused_from, held.id);
  const request = { ...SMALL, seed: 3, reuse: false };
  const [first, second, other] = await Promise.all([
    client.submit(request, { idempotencyKey: "one" }),
    client.submit(request, { idempotencyKey: "one" }),
    client.submit(request),
  ]);
  assert.equal(first.id, second.id);
  assert.notEqual(first.id, other.id);
  assert((await problemOf(client.submit({ seed: 4 }, { idempotencyKey: "one" }))).is("idempotency-key-reused"));
});

test("faults have their places", async () => {
  const request = { spec: { collision: { gap_um: -3 }, colour: "red" } as object, labels: { a: "b" } };
  for (const call of [() => client.submit(request), () => client.validate(request)]) {
    const error = await problemOf(call());
    assert.equal(error.status, 422);
    assert(error.is("queue-full", "invalid-request") && !error.is("unauthorized"));
    assert.deepEqual(error.errors.map((fault) => fault.pointer), ["/spec/collision/gap_um", "/spec/colour"]);
    assert(error.requestId && error.message.includes("/spec/colour: unknown field"));
  }
  const valid = await client.validate({ ...SMALL, seed: 1 });
  assert.equal(valid.digest, model.digest);
  assert(valid.cost.vertices > 0);
  assert.deepEqual((await problemOf(client.listPage({ status: "ended" as "failed" }))).errors[0]?.parameter, "status");
});

test("models are listed by pages and conditions", async () => {
  const batch = await client.submitBatch({ ...SMALL, seeds: [11, 12, 13], labels: { kind: "listed" } });
  const found = await all(client.list({ labels: { kind: "listed" } }, { pageSize: 2, view: "summary" }));
  assert.deepEqual(found.map((one) => one.id).sort(), batch.models?.toSorted());
  assert.deepEqual((await all(client.list({ labels: { study: "A:3" } }))).map((one) => one.id), [model.id]);
  const page = await client.listPage({ created_after: new Date(model.created_at) }, { pageSize: 1 });
  assert(page.models.length === 1 && page.next);
  assert.deepEqual(await all(client.list({ created_before: "2020-01-01T00:00:00Z" })), []);
  for await (const one of client.list()) {
    assert(one.id);
    break;
  }
});

test("many models are counted, cancelled and deleted", async () => {
  const labels = { kind: "bulk" };
  const batch = await client.submitBatch({ ...ENDLESS, count: 5, labels });
  assert.deepEqual(await client.deleteAll({ labels }, { dryRun: true }), { count: 5, dry_run: true });
  const cancelled = await client.cancelAll({ labels, status: "queued" });
  assert(!cancelled.dry_run && cancelled.count >= 3);
  await client.cancelBatch(batch.id);
  assert.equal((await client.waitBatch(batch.id)).counts.cancelled, 5);
  assert.equal((await client.cancel(batch.models![4]!)).status, "cancelled");
  assert((await problemOf(client.retry(batch.models![4]!))).is("not-failed"));
  assert.equal((await client.deleteAll({ labels })).count, 5);
  assert.equal((await problemOf(client.deleteAll({}))).errors[0]?.parameter, "all");
  assert((await client.cancelAll({ all: true }, { dryRun: true })).dry_run);
  for (const count of [1000, 100]) await client.submitBatch({ ...ENDLESS, count, labels });
  const states: Operation[] = [];
  assert.equal((await client.deleteAll({ labels }, { onProgress: (state) => states.push(state) })).count, 1100);
  const end = states.at(-1)!;
  assert(states.length > 1 && end.status === "succeeded" && end.progress.total === 1100);
  assert.deepEqual(await client.getOperation(end.id), end);
  assert.deepEqual(await client.cancelOperation(end.id), end);
  assert((await all(client.listOperations({ pageSize: 1 }))).some(({ id }) => id === end.id));
});

test("a study is checked, grown, and read as a table and an archive", async () => {
  const request = {
    ...SMALL,
    seeds: [1, 2],
    vary: { design: "grid" as const, values: { "/friction": [0.2, 0.3] } },
  };
  const valid = await client.validateBatch(request);
  assert.deepEqual([valid.models, valid.points.length], [4, 2]);
  const { id } = await client.submitBatch(request);
  const seen = new Set<string>();
  const ended = await client.waitBatch(id, { onProgress: (state) => seen.add(state.id) });
  assert.deepEqual([ended.counts.succeeded, seen.size], [4, 4]);
  const table = await client.table(id);
  const [status, friction] = ["status", "/friction"].map((name) => table.columns.indexOf(name)) as [number, number];
  assert.deepEqual(table.rows.map((row) => row[friction]), [0.2, 0.2, 0.3, 0.3]);
  assert(table.rows.every((row) => row[status] === "succeeded"));
  const csv = await client.tableCsv(id);
  assert.equal(csv, await (await fetch(await client.tableUrl(id))).text());
  assert.equal(csv.trim().split("\r\n").length, 5);
  const archive = await client.archive(id, { files: ["report.json"], format: "tar" });
  const tar = Buffer.from(await archive.arrayBuffer());
  assert.equal(tar.subarray(0, 13).toString(), "manifest.json");
  const zip = await fetch(await client.archiveUrl(id));
  assert.equal(Buffer.from(await zip.arrayBuffer()).subarray(0, 2).toString(), "PK");
  assert.deepEqual((await all(client.listBatches({}, { pageSize: 1 }))).filter((one) => one.id === id).length, 1);
  assert.equal((await client.cancelBatch(id)).counts.succeeded, 4);
  await client.deleteBatch(id);
  assert((await problemOf(client.getBatch(id))).is("batch-not-found"));
});

test("a fit is checked, followed to its result, listed and deleted", async () => {
  const request = { ...FIT, labels: { kind: "fit" }, priority: 1 };
  const valid = await client.validateFit(request);
  assert(valid.seconds > 0 && valid.request.targets?.[0]?.low === 95);
  const [submitted, again] = [
    await client.submitFit(request, { idempotencyKey: "fit" }),
    await client.submitFit(request, { idempotencyKey: "fit" }),
  ];
  const { id } = submitted;
  assert.deepEqual([again.id, submitted.digest], [id, valid.digest]);
  const events = await all(client.followFit(id));
  const types = events.map((event) => event.type);
  assert(types[0] === "status" && types.includes("progress"), types.join());
  assert.equal(types.indexOf("end"), types.length - 1);
  const last = events.at(-1)!;
  assert(last.fit.status === "succeeded" && last.fit.result && !last.fit.request);
  assert.deepEqual(await all(client.followFit(id, { lastEventId: last.id })), []);

  const states: string[] = [];
  const done = await client.waitFit(id, { onProgress: (fit) => states.push(fit.status) });
  assert.deepEqual([states, done.result], [["succeeded"], last.fit.result]);
  assert.deepEqual(done.request, valid.request);
  assert.equal(done.result?.unmet[0]?.quantity, "lumen_perimeter_mm");
  assert.equal(done.progress?.models, done.result?.models.length);

  const gone = await client.submitFit(ENDLESS_FIT);
  const ids = async (...list: Parameters<Oviduct["listFits"]>) => (await all(client.listFits(...list))).map((fit) => fit.id);
  assert.deepEqual(await ids({}, { pageSize: 1 }), [gone.id, id]);
  const created_after = new Date(gone.created_at);
  assert.deepEqual(await ids({ labels: { kind: "fit" }, preset: "pig", created_before: created_after }), [id]);
  assert.deepEqual(await ids({ created_after }), [gone.id]);
  assert.deepEqual(await ids({ status: "failed" }), []);
  const page = await client.listFitsPage({ status: "succeeded" }, { pageSize: 1 });
  assert.deepEqual([page.fits.length, page.next ?? null, page.fits[0]?.result], [1, null, undefined]);

  // One fit is followed while it is cancelled, and one while it is deleted.
  for await (const { type } of client.followFit(gone.id)) if (type === "progress") await client.cancelFit(gone.id);
  assert.equal((await client.cancelFit(gone.id)).status, "cancelled");
  const deleted = await client.submitFit(ENDLESS_FIT);
  let end: FitEvent | undefined;
  for await (const event of client.followFit(deleted.id)) {
    if (!end) await client.deleteFit(deleted.id);
    end = event;
  }
  assert.deepEqual([end?.type, end?.fit], ["end", { id: deleted.id, status: "deleted" }]);
  await client.deleteFit(id);
  assert((await problemOf(client.getFit(id))).is("fit-not-found"));
  assert((await problemOf(client.waitFit(id))).is("fit-not-found"));
});

test("faults of a fit have their places", async () => {
  const request = {
    targets: [{ region: "ampulla", quantity: "folds", value: 30 }],
    vary: [{ parameter: "/nothing" }],
    labels: { study: 3 as unknown as string },
  };
  for (const call of [() => client.submitFit(request), () => client.validateFit(request)]) {
    const error = await problemOf(call());
    assert(error.status === 422 && error.is("invalid-request"));
    assert.deepEqual(error.errors.map((fault) => fault.pointer), [
      "/labels/study",
      "/targets/0/quantity",
      "/vary/0/parameter",
    ]);
  }
  const wrong = await problemOf(client.listFitsPage({ status: "ended" as "failed" }));
  assert.deepEqual(wrong.errors[0]?.parameter, "status");
});

test("many models are followed by one stream", async () => {
  const ids = [model.id, (await client.submit({ ...SMALL, seed: 21 })).id];
  const ended = (events: ModelEvent[]) => events.filter((event) => event.type === "end").map((event) => event.model.id);
  assert.deepEqual(ended(await all(client.follow({ ids }))).sort(), ids.toSorted());
  const gone = "00000000-0000-7000-8000-000000000000";
  const [last] = await all(client.follow({ ids: [gone] }));
  assert.deepEqual(last?.model, { id: gone, status: "deleted" });
  // A stream by label does not end.
  const labels = { followed: "later" };
  const { id } = await client.submit({ ...ENDLESS, seed: 22, labels });
  const stop = new AbortController();
  const cancelled = () => stop.abort(new Error("cancelled"));
  await assert.rejects(async () => {
    for await (const { type, model } of client.follow({ labels }, { signal: stop.signal, view: "full" })) {
      assert(model.status !== "deleted" && model.spec && model.id === id);
      if (type === "end") cancelled();
      else await client.cancel(id);
    }
  }, /^Error: cancelled$/);
});

test("files arrive whole, in parts and by links, and their references are absolute", async () => {
  const file = model.files.find((file) => file.name === "model.glb")!;
  assert.equal(file.href, `${service.url}/models/${model.id}/files/model.glb`);
  const hash = (bytes: ArrayBuffer) => createHash("sha256").update(Buffer.from(bytes)).digest("hex");
  const bytes = await client.bytes(model.id, "model.glb");
  assert.equal(hash(bytes), file.sha256);
  const response = await client.file(model.id, "model.glb");
  assert.equal(response.headers.get("etag"), `"${file.sha256}"`);
  assert.equal(hash(await response.arrayBuffer()), file.sha256);
  // The report arrives compressed; its entity tag contains the hash of the decoded bytes.
  const report = model.files.find((file) => file.name === "report.json")!;
  const compressed = await client.file(model.id, "report.json");
  assert.equal(compressed.headers.get("etag"), `W/"${report.sha256}"`);
  assert.equal(hash(await compressed.arrayBuffer()), report.sha256);
  assert.equal(hash(await client.bytes(model.id, "report.json")), report.sha256);
  assert.equal(hash(await (await fetch(await client.downloadUrl(model.id, "model.glb"))).arrayBuffer()), file.sha256);
  const [first, last] = [[0, 3] as const, -4].map((range) => client.bytes(model.id, "model.glb", { range }));
  assert.equal(Buffer.from(await first!).toString(), "glTF");
  assert.deepEqual(Buffer.from(await last!), Buffer.from(bytes).subarray(-4));
  assert((await problemOf(client.file(model.id, "no.glb"))).is("file-not-found"));
  assert((await problemOf(client.file(model.id, "model.glb", { range: [1e9, 2e9] }))).is("range-not-satisfiable"));
  for await (const event of client.follow(model.id)) {
    assert("files" in event.model && event.model.files[0]?.href === file.href);
  }
});

test("sections are the same as arrays and as JSON", async () => {
  const sections = await client.sections(model.id);
  assert.deepEqual([sections.header.units, sections.header.digest], ["um", model.digest]);
  assert(sections.length > 5);
  for (const section of sections) {
    const json = await client.section(model.id, section.index);
    assert.deepEqual([section.z_um, section.step, section.added], [json.z_um, json.step, json.added]);
    for (const ring of ["inner", "outer"] as const) {
      assert.deepEqual(Array.from(section[ring].ids), json[ring].ids);
      const points = Array.from(section[ring].x, (x, i) => [x, section[ring].y[i]]);
      assert.deepEqual(points, json[ring].points.map((point) => point.map(Math.fround)));
    }
    assert.equal(section.inner.x.length, section.innerPoints);
  }
  assert.throws(() => sections.section(sections.length), RangeError);
  const svg = await fetch(await client.sectionUrl(model.id, 0));
  assert.match(await svg.text(), /<svg/);
  const png = Buffer.from(await client.preview(model.id, { view: "isthmus", size: 48 }));
  assert.deepEqual([png.toString("latin1", 1, 4), png.readUInt32BE(16), png.readUInt32BE(20)], ["PNG", 48, 48]);
  const linked = await fetch(await client.previewUrl(model.id, { view: "isthmus", size: 48 }));
  assert.deepEqual(Buffer.from(await linked.arrayBuffer()), png);
  assert.deepEqual((await problemOf(client.preview(model.id, { size: 1 }))).errors[0]?.parameter, "size");
  assert((await problemOf(client.section(model.id, 9999))).is("section-not-found"));
});

test("the surface is cut across and along the tube, as points and as pictures", async () => {
  // Without lean, a cut at the position of a section equals the section.
  const { z_um, outer } = await client.section(model.id, 5);
  const cut = await client.cut(model.id, { z_um });
  assert.deepEqual([cut.model, cut.units, cut.file, cut.islands, cut.pockets], [model.id, "um", "model.glb", 0, 0]);
  assert.deepEqual([cut.plane.normal, cut.plane.u, cut.plane.v], [[0, 0, 1], [1, 0, 0], [0, 1, 0]]);
  assert.deepEqual(cut.rings.map(({ kind, parent }) => [kind, parent]), [["tissue", null], ["lumen", 0]]);
  const area = (points: number[][]) => points.reduce((sum, [x, y], i) => sum + points.at(i - 1)![0]! * y! - x! * points.at(i - 1)![1]!, 0) / 2;
  const [tissue, lumen] = cut.rings.map(({ points }) => area(points)) as [number, number];
  assert(tissue > 0 && lumen < 0 && Math.abs(tissue / area(outer.points) - 1) < 1e-3, JSON.stringify([tissue, lumen]));
  assert(Math.abs((tissue + lumen) / cut.tissue_area_um2 - 1) < 1e-6);
  const along = await client.cut(model.id, { origin_um: [0, 0, z_um], normal: [0, 2, 0] });
  assert.deepEqual(along.plane.normal, [0, 1, 0]);

  assert.match(await (await fetch(await client.cutUrl(model.id, { z_um }))).text(), /<svg/);
  const json = (await (await fetch(await client.cutUrl(model.id, { z_um }, { format: "json" }))).json()) as typeof cut;
  assert.deepEqual(json.rings, cut.rings);
  for (const options of [{ size: 64 }, { size: 64, stain: "he" }, { size: 64, labels: true }] as const) {
    for (const slide of [await client.cutPicture(model.id, { z_um }, options), await client.sectionPicture(model.id, 5, options)]) {
      const png = Buffer.from(slide.png);
      assert.deepEqual([png.toString("latin1", 1, 4), Math.max(png.readUInt32BE(16), png.readUInt32BE(20))], ["PNG", 64]);
      assert(slide.um_per_pixel > 10 && slide.um_per_pixel < 200, String(slide.um_per_pixel));
    }
  }
  const linked = await fetch(await client.cutUrl(model.id, { z_um }, { format: "png", size: 64, labels: true }));
  assert.deepEqual(await linked.arrayBuffer(), (await client.cutPicture(model.id, { z_um }, { size: 64, labels: true })).png);
  assert((await problemOf(client.cut(model.id, { z_um: 1e6 }))).is("cut-not-found"));
  assert.equal((await problemOf(client.cut(model.id, { origin_um: [0, 0, 0], normal: [0, 0, 0] }))).errors[0]?.parameter, "normal");
});

test("a way leads through the lumen from end to end", async () => {
  const { model: own, clearance_um, length_mm, points } = await client.way(model.id);
  assert.equal(own, model.id);
  assert(clearance_um > 0 && points.every((point) => point.clearance_um >= clearance_um));
  assert(points.every(({ s_mm }, k) => k === 0 || s_mm > points[k - 1]!.s_mm));
  assert(points.every(({ tangent }) => Math.abs(Math.hypot(...tangent) - 1) < 1e-6));
  const steps = points.slice(1).map(({ position_mm }, k) => {
    return Math.hypot(...position_mm.map((value, axis) => value - points[k]!.position_mm[axis]!));
  });
  assert(Math.abs(steps.reduce((sum, step) => sum + step, 0) / length_mm - 1) < 1e-3);
  assert((await problemOf(client.way("00000000-0000-7000-8000-000000000000"))).is("model-not-found"));
});

test("a leaning surface has islands in planar cuts", async () => {
  const { id } = await client.submit({
    preset: "paper",
    seed: 3,
    spec: {
      steps: 400,
      length_mm: 20,
      sway: { strength: 5 },
      lean: { strength_um: 650 },
    },
  });
  assert.equal((await client.wait(id)).status, "succeeded");
  const end = (await client.sections(id)).entries.at(-1)!.z_um;
  const cuts = await Promise.all([0.5, 0.6, 0.7, 0.8, 0.9].map((part) => client.cut(id, { z_um: part * end })));
  assert(cuts.some(({ islands }) => islands > 0));
  for (const { islands, pockets, rings } of cuts) {
    const of = (wanted: string) => rings.filter(({ kind }) => kind === wanted).length;
    assert.deepEqual([of("island"), of("pocket")], [islands, pockets]);
    assert(rings.every(({ parent }, i) => parent === null || parent < i));
  }
  const report = await client.report(id);
  assert(report.cuts && report.cuts.with_islands <= 1 && report.lean && report.lean.scale > 0);
});

test("the service describes itself", async () => {
  const { presets } = await client.presets();
  assert.equal(presets[0]?.["name"], "pig");
  assert((await client.preset("pig"))["name"]);
  assert((await problemOf(client.preset("dragon"))).is("preset-not-found"));
  assert((await client.schema())["properties"]);
  const manifest = await client.manifest(model.id);
  assert.deepEqual(manifest.files.map((file) => file.sha256), model.files.map((file) => file.sha256));
  const course = await client.course(model.id);
  assert.deepEqual([course.model, course.shape, course.points.length, course.points[0]?.u], [model.id, "straight", 2, [1, 0, 0]]);
  const report = await client.report(model.id);
  assert(report.digest === model.digest && report["certificate"]);
  assert.equal((await client.health()).status, "ok");
  assert.equal((await client.ready()).status, "ok");
  const [worker] = (await client.workers()).workers;
  assert.equal((await client.pauseWorker(worker!.id)).state, "paused");
  assert.equal((await client.resumeWorker(worker!.id)).state, "active");
  assert((await client.pauseWorkers()).pause);
  assert(!(await client.resumeWorkers()).pause);
  assert((await problemOf(client.drainWorker("nobody"))).is("worker-not-found"));
});

test("a service behind a prefix is used like one at a root", async () => {
  await withServer(proxy("/lab/oviduct", service.url), async (url) => {
    for (const base of [`${url}/lab/oviduct`, new URL(`${url}/lab/oviduct/`)]) {
      const behind = new Oviduct(base);
      assert.equal(behind.url, `${url}/lab/oviduct/`);
      const { id } = await behind.submit({ ...SMALL, seed: 31 });
      const done = await behind.wait(id);
      assert.equal(done.files[0]?.href, `${url}/lab/oviduct/models/${id}/files/${done.files[0]?.name}`);
      const [event] = await all(behind.follow({ ids: [id] }));
      assert.deepEqual((event?.model as Model).files, done.files);
      assert((await fetch(done.files[0]!.href)).ok);
      assert.equal((await behind.listPage({}, { pageSize: 1 })).models[0]?.files[0]?.href, done.files[0]?.href);
    }
  });
});

test("a stuck path is refused before anything is sent", () => {
  for (const id of ["", ".", ".."]) assert.throws(() => client.get(id), TypeError);
});

test("with keys, each call has the rights of the key, and links have tickets", async () => {
  await withService([], async (closed) => {
    const key = await closed.key();
    const own = new Oviduct(closed.url, { key });
    const { id } = await own.submit({ ...SMALL, seed: 1 });
    assert.equal((await own.wait(id)).owner, "lab");
    for (const wrong of [undefined, `${key.slice(0, -4)}AAAA`]) {
      const error = await problemOf(new Oviduct(closed.url, { key: wrong }).get(id));
      assert.deepEqual([error.status, error.is("unauthorized")], [401, true]);
    }
    assert((await problemOf(own.pauseWorkers())).is("forbidden"));
    const reader = new Oviduct(closed.url, { key: await closed.key("--scopes", "read") });
    assert((await problemOf(reader.submit({ ...SMALL }))).is("forbidden"));
    const url = await own.downloadUrl(id, "model.glb");
    assert(!url.includes(key) && url.includes("?ticket=ovt_"), "a ticket instead of the key");
    const first = await fetch(url);
    assert.equal((await first.arrayBuffer()).byteLength, (await own.bytes(id, "model.glb")).byteLength);
    assert.equal((await fetch(url)).status, 401, "a ticket is good for one request");
    assert((await fetch(await own.sectionUrl(id, 0))).headers.get("content-type")?.startsWith("image/svg+xml"));
    assert((await fetch(await own.cutUrl(id, { z_um: 100 }))).headers.get("content-type")?.startsWith("image/svg+xml"));
    assert((await fetch(await own.reportPageUrl(id))).headers.get("content-type")?.startsWith("text/html"));
    await withServer(proxy("/p", closed.url), async (url) => {
      const link = await new Oviduct(`${url}/p`, { key }).downloadUrl(id, "model.glb");
      assert(link.startsWith(`${url}/p/models/`) && (await fetch(link)).ok);
    });
  });
});

test("a key with a rate is slowed down, not refused", async () => {
  await withService([], async (closed) => {
    const key = await closed.key("--rate", "1");
    const hasty = new Oviduct(closed.url, { key, attempts: 1 });
    const results = await Promise.allSettled(Array.from({ length: 8 }, () => hasty.presets()));
    const refused = results.find((result) => result.status === "rejected")?.reason as OviductError;
    assert(refused.is("rate-limited") && refused.status === 429);
    assert((refused.retryAfter ?? 0) >= 1);
    const patient = new Oviduct(closed.url, { key });
    assert((await patient.presets()).presets.length > 0);
    const brief = new Oviduct(closed.url, { key, maxDelay: 10 });
    await assert.rejects(Promise.all(Array.from({ length: 8 }, () => brief.presets())), OviductError);
  });
});

test("a failed model says why, and is grown again as a new one", async () => {
  await withService(["--job-timeout", "100ms"], async (short) => {
    const own = new Oviduct(short.url);
    const failed = await own.wait((await own.submit({ ...ENDLESS, seed: 1 })).id);
    assert.equal(failed.status, "failed");
    assert.match(failed.problem?.type ?? "", /^urn:oviduct:problem:/);
    const again = await own.retry(failed.id, { idempotencyKey: "again" });
    assert.deepEqual([again.retry_of, again.seed], [failed.id, 1]);
    assert.equal((await own.retry(failed.id, { idempotencyKey: "again" })).id, again.id);
  });
});
