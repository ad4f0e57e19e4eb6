// Growing models: shown immediately, and across reloads and restarts of the service.
import assert from "node:assert/strict";
import { after, test } from "node:test";
import { ENDLESS, SMALL, withService, type Service } from "../../../clients/typescript/test/service.ts";
import { Oviduct, type ModelRequest, type Vary } from "../../../clients/typescript/src/index.ts";
import { closeBrowser, colours, picture, Visit } from "./browser.ts";

after(closeBrowser);

/** The shown position of a section. */
async function place(visit: Visit): Promise<number> {
  const text = await visit.page.getByRole("heading", { name: /^Section at/ }).textContent();
  return Number(/[\d.]+/.exec(text ?? "")?.[0]);
}

async function grows(visit: Visit): Promise<void> {
  const before = await place(visit);
  for (;;) {
    const now = await place(visit);
    if (now > before) return;
    await visit.page.waitForTimeout(100);
  }
}

/** Collects the positions of sections that the page shows from this call on. */
async function collectPlaces(visit: Visit): Promise<() => Promise<string[]>> {
  await visit.page.evaluate(() => {
    const places = new Set<string>();
    new MutationObserver(() => {
      for (const heading of document.querySelectorAll("h2")) {
        if (heading.textContent.startsWith("Section at")) places.add(heading.textContent);
      }
    }).observe(document.body, { subtree: true, childList: true, characterData: true });
    Object.assign(window, { places });
  });
  return () => visit.page.evaluate(() => [...(window as unknown as { places: Set<string> }).places]);
}

/** Marks the page; a reload removes the mark. */
async function mark(visit: Visit): Promise<void> {
  await visit.page.evaluate(() => Object.assign(window, { marked: true }));
}

async function isMarked(visit: Visit): Promise<boolean> {
  return visit.page.evaluate(() => "marked" in window);
}

async function submit(service: Service, request: ModelRequest): Promise<string> {
  const { id } = await new Oviduct(service.url).submit({ ...request, reuse: false });
  return id;
}

test("a newcomer grows a model with one click and sees it change", async () => {
  await withService([], async ({ url }) => {
    const visit = await Visit.open(url);
    const { page } = visit;
    await mark(visit);
    await visit.accessible();
    // The page is open before the first section, however slowly it is drawn.
    const client = new Oviduct(url);
    await client.pauseWorkers();
    await page.getByRole("button", { name: "Grow an oviduct" }).click();
    await page.waitForURL("**#/models/*");
    await page.getByRole("heading", { level: 1 }).getByText("queued").waitFor();
    const places = await collectPlaces(visit);
    await client.resumeWorkers();
    await page.getByRole("application", { name: /^3D view/ }).waitFor({ timeout: 180_000 });
    assert((await places()).length > 1, "it was not seen to change");
    assert(await isMarked(visit), "the page was loaded again");
    // The list has changed, too.
    await page.getByRole("link", { name: "Models", exact: true }).click();
    await page.getByRole("listitem", { name: /^Pig oviduct, seed/ }).getByText("succeeded").waitFor();
    assert(await isMarked(visit), "the page was loaded again");
    await visit.accessible();
    await visit.close();
  });
});

test("a page that is loaded again in the middle goes on", async () => {
  await withService([], async (service) => {
    const id = await submit(service, ENDLESS);
    const visit = await Visit.open(`${service.url}/#/models/${id}`);
    await grows(visit);
    await visit.accessible();
    const before = await place(visit);
    const tube = visit.page.getByRole("img", { name: /^The growing tube in 3D/ });
    const seen = async () => Number(/\d+(?= sections seen)/.exec((await tube.getAttribute("aria-label"))!)![0]);
    while ((await seen()) < 10) await visit.page.waitForTimeout(100);
    await visit.page.reload();
    await grows(visit);
    assert((await place(visit)) > before);
    assert((await seen()) > 10, "the tube began anew");
    await visit.close();
  });
});

test("a service that is restarted in the middle is waited for", async () => {
  await withService([], async (service) => {
    const id = await submit(service, ENDLESS);
    const visit = await Visit.open(`${service.url}/#/models/${id}`);
    const { page } = visit;
    await mark(visit);
    await grows(visit);
    visit.away = true;
    await service.kill();
    await page.getByText("The service does not answer.").waitFor();
    await service.start();
    await page.getByText("The service does not answer.").waitFor({ state: "detached" });
    visit.away = false;
    await grows(visit);
    await new Oviduct(service.url).cancel(id);
    await page.getByRole("heading", { level: 1 }).getByText("cancelled").waitFor();
    assert(await isMarked(visit), "the page was loaded again");
    await visit.close();
  });
});

test("the growing tube comes back after the loss of the graphics context", async () => {
  await withService([], async (service) => {
    const id = await submit(service, ENDLESS);
    const visit = await Visit.open(`${service.url}/#/models/${id}`);
    const { page } = visit;
    await grows(visit);
    const tube = page.getByRole("img", { name: /^The growing tube in 3D/ });
    await tube.waitFor();
    const context = await tube.evaluateHandle((canvas) => (canvas as HTMLCanvasElement).getContext("webgl2")!.getExtension("WEBGL_lose_context")!);
    await context.evaluate((context) => context.loseContext());
    await page.getByText(/The tube is not shown in 3D: the browser/).waitFor();
    await tube.waitFor({ state: "hidden" });
    await context.evaluate((context) => context.restoreContext());
    await tube.waitFor();
    assert(colours(await picture(tube)) > 50, "the tube is not drawn again");
    await visit.close();
  });
});

test("a growing model is cancelled, grown again, and deleted", async () => {
  await withService([], async (service) => {
    const id = await submit(service, ENDLESS);
    const visit = await Visit.open(`${service.url}/#/models/${id}`);
    const { page } = visit;
    await grows(visit);
    await page.getByRole("button", { name: "Cancel" }).click();
    await page.getByRole("heading", { level: 1 }).getByText("cancelled").waitFor();
    assert.equal((await new Oviduct(service.url).get(id)).status, "cancelled");
    await page.getByRole("button", { name: "Another seed" }).click();
    await page.waitForURL((url) => url.hash.startsWith("#/models/") && !url.hash.includes(id));
    const other = new URL(page.url()).hash.split("/")[2]!;
    await page.getByRole("button", { name: "Delete" }).click();
    await page.getByRole("dialog").getByRole("button", { name: "Delete" }).click();
    await page.waitForURL((url) => url.hash === "#/");
    const left = await new Oviduct(service.url).listPage();
    assert.deepEqual(left.models.map((model) => model.id), [id]);
    assert.notEqual(other, id);
    await visit.close();
  });
});

test("a model that has failed is grown again with its seed", async () => {
  await withService(["--job-timeout", "1s"], async (service) => {
    const client = new Oviduct(service.url);
    const id = await submit(service, { ...ENDLESS, seed: 12 });
    const visit = await Visit.open(`${service.url}/#/models/${id}`);
    const { page } = visit;
    await page.getByText("It needed more time than a worker may spend on one model.").waitFor();
    await visit.accessible();
    await page.getByRole("button", { name: "Retry" }).click();
    await page.getByRole("link", { name: "Retry of a failed model" }).waitFor();
    const other = new URL(page.url()).hash.split("/")[2]!;
    const { seed, retry_of } = await client.get(other);
    assert.deepEqual([seed, retry_of], [12, id]);
    await visit.close();
  });
});

test("the list is filtered and follows the queue", async () => {
  await withService(["--cpu-workers", "0"], async (service) => {
    const client = new Oviduct(service.url);
    await client.submit({ ...SMALL, seed: 1, labels: { lab: "a" } });
    const visit = await Visit.open(`${service.url}/#/?label=lab:a`);
    const { page } = visit;
    await page.getByText(/No worker/).first().waitFor();
    const rows = page.getByRole("listitem", { name: /^Pig oviduct/ });
    await rows.first().waitFor();
    await client.submit({ ...SMALL, seed: 2, labels: { lab: "b" } });
    await client.submit({ ...SMALL, seed: 3, labels: { lab: "a" } });
    await page.getByRole("listitem", { name: "Pig oviduct, seed 3" }).waitFor();
    assert.equal(await rows.count(), 2);
    await visit.accessible();
    await page.getByRole("button", { name: "Cancel all that match …" }).click();
    await page.getByRole("dialog").getByRole("button", { name: "Cancel them" }).click();
    await rows.first().getByText("cancelled").waitFor();
    const { models } = await client.listPage();
    assert.deepEqual(models.map(({ seed, status }) => [seed, status]), [[3, "cancelled"], [2, "queued"], [1, "cancelled"]]);
    await visit.close();
  });
});

test("models of equal preset and seed have names of their own", async () => {
  await withService(["--cpu-workers", "0"], async (service) => {
    const client = new Oviduct(service.url);
    const ids = await Promise.all([28, 34].map(async (gap_um) => (await client.submit({ seed: 3, spec: { collision: { gap_um } } })).id));
    await client.submit({ seed: 4 });
    const visit = await Visit.open(service.url);
    const { page } = visit;
    await page.getByRole("button", { name: "Delete Pig oviduct, seed 4", exact: true }).waitFor();
    for (const id of ids) {
      const name = `Pig oviduct, seed 3, ${id.slice(-6)}`;
      await page.getByRole("button", { name: `Delete ${name}`, exact: true }).waitFor();
      const link = page.getByRole("listitem", { name, exact: true }).getByRole("link", { name: name.replace(",", ""), exact: true });
      assert.equal(new URL((await link.getAttribute("href"))!, service.url).hash, `#/models/${id}`);
    }
    await visit.close();
  });
});

test("a long list is drawn in part, and the focus stays in it", async () => {
  await withService(["--cpu-workers", "0"], async (service) => {
    const client = new Oviduct(service.url);
    await client.submitBatch({ ...SMALL, seeds: Array.from({ length: 120 }, (_, k) => k + 1) });
    const visit = await Visit.open(service.url);
    const { page } = visit;
    const rows = page.getByRole("listitem", { name: /^Pig oviduct/ });
    const older = page.getByRole("button", { name: "Show older models" });
    const focused = () => page.evaluate(() => document.activeElement?.closest("li")?.getAttribute("aria-label") ?? document.activeElement?.textContent);
    await older.waitFor();
    assert.equal(await rows.count(), 50);
    await client.submit({ ...SMALL, seed: 500 });
    await page.getByRole("listitem", { name: "Pig oviduct, seed 500" }).waitFor();
    assert.equal(await rows.count(), 50);
    await older.click();
    await rows.nth(99).waitFor();
    await older.click();
    await rows.nth(120).waitFor();
    await older.waitFor({ state: "detached" });
    assert.equal(new Set(await rows.evaluateAll((rows) => rows.map((row) => row.ariaLabel))).size, 121);

    const [first, second] = [rows.nth(1), await rows.nth(2).getAttribute("aria-label")];
    const remove = first.getByRole("button", { name: /^Delete/ });
    await remove.click();
    await page.getByRole("button", { name: "Keep" }).click();
    await page.getByRole("dialog").waitFor({ state: "detached" });
    assert(await remove.evaluate((button) => button === document.activeElement), "the focus is not where it was");
    await remove.click();
    await page.getByRole("dialog").getByRole("button", { name: "Delete" }).click();
    await page.waitForFunction((name) => document.activeElement?.closest("li")?.ariaLabel === name, second);

    await page.getByRole("button", { name: "Select all shown" }).click();
    await page.getByText("120 selected").waitFor();
    await page.getByRole("button", { name: "Clear" }).click();
    assert.match(String(await focused()), /Models/);
    await visit.close();
  });
});

test("deeds on several models go on after one that fails", async () => {
  await withService(["--cpu-workers", "0"], async (service) => {
    const client = new Oviduct(service.url);
    for (let seed = 1; seed <= 6; seed++) await client.submit({ ...SMALL, seed });
    const visit = await Visit.open(service.url, {}, [404, 409]);
    const { page } = visit;
    const rows = page.getByRole("listitem", { name: /^Pig oviduct/ });
    await rows.nth(5).waitFor();
    const { models } = await client.listPage();
    const [gone, refused] = models.map(({ id }) => id);
    const problem = { type: "urn:oviduct:problem:conflict", title: "Conflict", status: 409, detail: "Not this one." };
    const json = (status: number, body: object) => ({ status, contentType: "application/problem+json", body: JSON.stringify(body) });
    await page.route(`**/models/${refused}`, (route) => route.fulfill(json(409, problem)));
    const missing = { type: "urn:oviduct:problem:model-not-found", title: "No model", status: 404, detail: "There is none." };
    await page.route(`**/models/${gone}`, (route) => route.fulfill(json(404, missing)));
    await page.getByRole("button", { name: "Select all shown" }).click();
    await page.getByRole("region", { name: "Selected models" }).getByRole("button", { name: "Delete" }).click();
    await page.getByRole("button", { name: "Delete them" }).click();
    await page.getByText("5 of 6 models deleted; 1 failed: Not this one.").waitFor();
    assert.equal(await rows.count(), 1);
    assert(await rows.getByRole("checkbox").isChecked());
    assert.deepEqual((await client.listPage()).models.map(({ id }) => id).sort(), [gone, refused].sort());
    await visit.close();
  });
});

test("a model that no longer matches is not deleted with the others", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const client = new Oviduct(url);
    const { id } = await client.submit({ ...SMALL, seed: 1 });
    await client.submit({ ...SMALL, seed: 2 });
    const visit = await Visit.open(`${url}/#/?status=queued`);
    const { page } = visit;
    await page.route("**/models?*", async (route) => {
      const request = route.request();
      const deletes = request.method() === "DELETE" && !request.url().includes("dry_run=true");
      // The page has not yet learned of the cancellation.
      if (deletes) await client.cancel(id);
      await route.continue();
    });
    await page.getByRole("button", { name: "Delete all that match …" }).click();
    const dialog = page.getByRole("dialog", { name: "Delete all models that match?" });
    await dialog.getByText(/^2 models/).waitFor();
    await dialog.getByRole("button", { name: "Delete them" }).click();
    await page.getByText("1 model deleted.").waitFor();
    await page.getByRole("link", { name: "Show all" }).click();
    const row = (seed: number) => page.getByRole("listitem", { name: `Pig oviduct, seed ${seed}` });
    await row(1).getByText("cancelled").waitFor();
    await row(2).waitFor({ state: "detached" });
    await visit.close();
  });
});

test("a study is followed to its table", async () => {
  await withService([], async (service) => {
    const client = new Oviduct(service.url);
    const vary: Vary = { design: "grid", values: { "/collision/gap_um": [28, 34] } };
    const { id } = await client.submitBatch({ ...SMALL, seeds: [1, 2], vary });
    const visit = await Visit.open(`${service.url}/#/batches/${id}`);
    const { page } = visit;
    await mark(visit);
    await page.getByText(/4 succeeded|4 of 4/).first().waitFor({ timeout: 180_000 });
    assert.equal(await page.getByRole("table").getByRole("row").count(), 5);
    const names = await page.getByRole("link", { name: /^Model with seed/ }).evaluateAll((links) => links.map((link) => link.ariaLabel));
    assert.equal(new Set(names).size, 4);
    await page.getByRole("img", { name: /^Tissue volume, mm³ against Lumen gap, µm, 4 models/ }).waitFor();
    await page.getByRole("combobox", { name: "against" }).selectOption({ label: "Surface" });
    await page.getByRole("img", { name: /^Tissue volume, mm³ against Surface, mm², 4 models/ }).waitFor();
    assert(await isMarked(visit), "the page was loaded again");
    await visit.accessible();
    await visit.close();
  });
});
