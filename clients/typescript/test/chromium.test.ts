// A page of another origin uses the client in Chromium, with an API key and tickets.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFile } from "node:fs/promises";
import type { RequestListener } from "node:http";
import { test } from "node:test";
import { chromium, type Page } from "playwright-core";
import { Oviduct, type Batch, type Fit, type Model, type SectionJson } from "oviduct-client";
import { ENDLESS, FIT, Service, SMALL, withServer } from "./service.js";

const EXECUTABLE = process.env["CHROMIUM"] ?? "/usr/bin/chromium";
const FLAGS = ["--no-sandbox", "--headless", "--disable-gpu", "--disable-background-networking"];

/** Serves the page and the built client. */
const files: RequestListener = async (request, answer) => {
  const { pathname } = new URL(request.url ?? "/", "http://page");
  const root = new URL("../", import.meta.url);
  const file = pathname === "/" ? "test/page.html" : pathname.replace(/^\/client\//, "dist/");
  const type = file.endsWith(".html") ? "text/html" : "text/javascript";
  const text = await readFile(new URL(file, root)).catch(() => undefined);
  answer.writeHead(text ? 200 : 404, { "content-type": type }).end(text);
};

function sha256(bytes: Uint8Array): string {
  return createHash("sha256").update(bytes).digest("hex");
}

interface Seen {
  id: string;
  type: string;
  status: string;
  attempts: number;
  connection: number;
}

interface Loaded {
  etag: string;
  bytes: number[];
  count: number;
  points: number;
  first: SectionJson;
  picture: number;
}

/** Calls a function of the page. */
function call<T>(page: Page, name: string, ...values: unknown[]): Promise<T> {
  return page.evaluate(
    ([name, values]) => (globalThis as unknown as Record<string, (...v: unknown[]) => unknown>)[name]!(...values),
    [name, values] as const,
  ) as Promise<T>;
}

test("a page of another origin submits, follows through a restart, and downloads", async () => {
  await withServer(files, async (own) => {
    // A foreign host name makes the page insecure, so it has neither hash functions nor UUIDs.
    const plain = own.replace("127.0.0.1", "lab.example");
    const service = await Service.start("--cors-origin", own, "--cors-origin", plain);
    const browser = await chromium.launch({
      executablePath: EXECUTABLE,
      args: [...FLAGS, "--host-resolver-rules=MAP lab.example 127.0.0.1"],
    });
    try {
      const key = await service.key();
      const client = new Oviduct(service.url, { key });
      const page = await browser.newPage();
      const errors: Error[] = [];
      page.on("pageerror", (error) => errors.push(error));
      const seen: Seen[] = [];
      let restarted: Promise<void> | undefined;
      let before = 0;
      await page.exposeFunction("seen", async (event: Seen) => {
        seen.push(event);
        if (event.type === "progress" && !restarted) {
          before = seen.length;
          restarted = service.kill().then(() => service.start());
        } else if (event.type === "progress" && event.attempts > 1) {
          await client.cancel(event.id);
        }
      });
      await page.goto(own);
      await page.waitForFunction("window.ready");

      assert.equal((await call<Model>(page, "follow", service.url, key, ENDLESS)).status, "cancelled");
      await restarted;
      const [early, late] = [seen.slice(0, before), seen.slice(before)];
      assert(early.some((event) => event.type === "progress" && event.attempts === 1), "progress before the restart");
      assert(late.some((event) => event.type === "progress" && event.attempts > 1), "progress after the restart");
      assert.deepEqual([seen.at(-1)?.type, seen.at(-1)?.status], ["end", "cancelled"]);
      assert.equal(seen.filter((event) => event.type === "end").length, 1);
      assert(early.every((event) => event.connection === 1) && late.at(-1)!.connection > 1, "by EventSource");
      const connections = (await page.evaluate("connections")) as string[];
      const tickets = connections.map((url) => new URL(url).searchParams.get("ticket"));
      assert(tickets.every((ticket) => ticket?.startsWith("ovt_")) && new Set(tickets).size === tickets.length);
      assert(connections.slice(1).every((url) => new URL(url).searchParams.has("last_event_id")));

      const model = await client.wait((await client.submit({ ...SMALL, seed: 5 })).id);
      const file = (name: string) => model.files.find((file) => file.name === name)!;
      const [download, link] = await Promise.all([
        page.waitForEvent("download"),
        call<string>(page, "download", service.url, key, model.id),
      ]);
      assert.match(download.suggestedFilename(), /^pig-5-model\.glb$/);
      assert.equal(sha256(await readFile(await download.path())), file("model.glb").sha256);
      assert(![link, ...connections].some((url) => url.includes(key)), "no URL has the key");

      const loaded = await call<Loaded>(page, "load", service.url, key, model.id);
      assert.equal(loaded.etag, `"${file("sections.bin").sha256}"`);
      assert.equal(`"${sha256(Uint8Array.from(loaded.bytes))}"`, loaded.etag);
      assert.deepEqual([loaded.count, loaded.points], [loaded.first.count, loaded.first.inner.points.length]);
      assert(loaded.picture > 0, "a picture with a ticket");

      const batch = await call<Batch>(page, "batch", service.url, key, { ...SMALL, seeds: [1, 2] });
      assert.equal(batch.counts.succeeded, 2);

      const fit = await call<Fit>(page, "fit", service.url, key, FIT);
      assert.equal(fit.status, "succeeded");
      const opened = (await page.evaluate("connections")) as string[];
      assert(opened.some((url) => url.includes(`/fits/${fit.id}/events?ticket=ovt_`)), "by EventSource");

      const unknown = await call(page, "problem", service.url, key);
      const type = "urn:oviduct:problem:model-not-found";
      assert.deepEqual(unknown, { name: "OviductError", type, secure: true });
      const wrong = await call(page, "problem", service.url, `${key.slice(0, -4)}AAAA`);
      assert.deepEqual(wrong, { name: "OviductError", type: "urn:oviduct:problem:unauthorized", secure: true });

      await page.goto(plain);
      await page.waitForFunction("window.ready");
      const insecure = await call(page, "problem", service.url, key);
      assert.deepEqual(insecure, { name: "OviductError", type, secure: false });
      assert.equal((await call<Batch>(page, "batch", service.url, key, { ...SMALL, seeds: [3, 4] })).counts.succeeded, 2);
      assert.equal((await call<Loaded>(page, "load", service.url, key, model.id)).count, loaded.count);

      // The service does not know this origin, so no call succeeds.
      await page.goto(own.replace("127.0.0.1", "localhost"));
      await page.waitForFunction("window.ready");
      const refused = call(page, "problem", service.url, key);
      assert.equal(await Promise.race([refused.then(() => "answered"), page.waitForTimeout(1500)]), undefined);
      assert.deepEqual(errors, []);
    } catch (error) {
      console.error(service.log().split("\n").slice(-30).join("\n"));
      throw error;
    } finally {
      await browser.close();
      await service[Symbol.asyncDispose]();
    }
  });
});
