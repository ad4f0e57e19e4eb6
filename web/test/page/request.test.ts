// The form: faults at their fields, curves, and requests that match the page.
import assert from "node:assert/strict";
import { after, test } from "node:test";
import { Oviduct } from "../../../clients/typescript/src/index.ts";
import { withService } from "../../../clients/typescript/test/service.ts";
import { closeBrowser, Visit } from "./browser.ts";

after(closeBrowser);

test("a fault stands at its field until it is corrected", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(`${url}/#/new`);
    const { page } = visit;
    visit.refusals = [422];
    const length = page.getByRole("spinbutton", { name: /^Length/ }).or(page.getByRole("textbox", { name: /^Length/ }));
    await length.fill("5000");
    await page.getByText("One correction needed").waitFor();
    assert.equal(await length.getAttribute("aria-invalid"), "true");
    const described = (await length.getAttribute("aria-describedby"))!.split(" ");
    const words = await Promise.all(described.map((id) => page.locator(`[id="${id}"]`).textContent()));
    assert.match(words.join(" "), /1,?000/, "the fault states the limit");
    assert.equal(await page.locator("[aria-invalid=true]").count(), 1);
    await visit.accessible();
    await length.fill("55");
    await page.getByText("One correction needed").waitFor({ state: "detached" });
    assert.notEqual(await length.getAttribute("aria-invalid"), "true");
    await visit.close();
  });
});

test("what the form shows as JSON is what it sends", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(`${url}/#/new?preset=pig&seed=42`);
    const { page } = visit;
    await page.getByRole("spinbutton", { name: /^Length/ }).or(page.getByRole("textbox", { name: /^Length/ })).fill("41.5");
    // A curve can be changed by keyboard alone.
    await page.getByRole("button", { name: /curve of Lumen gap$/ }).click();
    const key = page.getByRole("slider", { name: /^Lumen gap, key 2 of/ });
    const before = await key.getAttribute("aria-valuetext");
    await key.focus();
    await page.keyboard.press("ArrowUp");
    assert.notEqual(await key.getAttribute("aria-valuetext"), before);
    await page.getByText("The same request as code").click();
    await page.getByRole("tab", { name: "JSON" }).click();
    const shown = JSON.parse((await page.getByRole("tabpanel").locator("pre").textContent())!);
    assert.equal(shown.seed, 42);
    assert.equal(shown.spec.length_mm, 41.5);
    assert(shown.spec.collision.gap_um.keys.length >= 2);
    const sent = page.waitForRequest((request) => request.method() === "POST" && request.url() === `${url}/models`);
    await page.getByRole("button", { name: "Grow the model" }).click();
    assert.deepEqual((await sent).postDataJSON(), shown);
    await page.waitForURL("**#/models/*");
    const { models } = await new Oviduct(url).listPage({}, { view: "full" });
    assert.equal(models.length, 1);
    assert.equal(models[0]!.spec!.length_mm, 41.5);
    await visit.close();
  });
});

test("a course through points is written one a line, and its faults stand there", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(`${url}/#/new?preset=pig`);
    const { page } = visit;
    visit.refusals = [422];
    await page.getByText("Course", { exact: true }).click();
    await page.getByRole("combobox", { name: "Shape" }).selectOption("points");
    const points = page.getByRole("textbox", { name: "Points" });
    await points.fill("0, 0, 0\n0, 0");
    await page.getByText("Point 2, “0, 0”, is not three numbers such as 0, 0, 12.").waitFor();
    await points.fill("0, 0, 0\n0, 0, 30\n0, 0, 30");
    await page.getByText("Entry 3 is the point before it.").waitFor();
    assert.equal(await points.getAttribute("aria-invalid"), "true");
    await visit.accessible();
    await points.fill("0, 0, 0\n0, 0, 30\n10, 0, 60");
    await page.getByText("One correction needed").waitFor({ state: "detached" });
    const sent = page.waitForRequest((request) => request.method() === "POST" && request.url() === `${url}/models`);
    await page.getByRole("button", { name: "Grow the model" }).click();
    assert.deepEqual((await sent).postDataJSON().spec, { course: { shape: "points", points_mm: [[0, 0, 0], [0, 0, 30], [10, 0, 60]] } });
    await visit.close();
  });
});

test("a key of a curve is dragged, within the bounds", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(`${url}/#/new?preset=pig`);
    const { page } = visit;
    await page.getByRole("button", { name: /curve of Lumen gap$/ }).click();
    const key = page.getByRole("slider", { name: /^Lumen gap, key 2 of/ });
    await key.scrollIntoViewIfNeeded();
    const state = async () => {
      const { x, y, width, height } = (await key.boundingBox())!;
      const value = async (name: string) => Number(await key.getAttribute(`aria-value${name}`));
      return { x: x + width / 2, y: y + height / 2, now: await value("now"), least: await value("min"), text: await key.getAttribute("aria-valuetext") };
    };
    type State = Awaited<ReturnType<typeof state>>;
    /** The state when it is as expected; a busy page draws late. */
    const drawn = async (expected: (state: State) => boolean) => {
      for (let waited = 0; waited < 5000 && !expected(await state()); waited += 50) await page.waitForTimeout(50);
      return state();
    };
    const before = await state();
    await page.mouse.move(before.x, before.y);
    await page.mouse.down();
    await page.mouse.move(before.x - 30, before.y + 20, { steps: 4 });
    // The scale stays while the schedule key is held.
    const follows = ({ x, y }: State) => Math.hypot(x - before.x + 30, y - before.y - 20) < 2;
    const during = await drawn(follows);
    assert(follows(during), JSON.stringify({ before, during }));
    assert(during.now < before.now && during.text !== before.text, JSON.stringify({ before, during }));
    await page.mouse.move(before.x - 30, before.y + 2000, { steps: 4 });
    await page.mouse.up();
    const after = await drawn(({ now, least }) => now === least);
    assert.equal(after.now, after.least);
    await page.mouse.move(before.x, before.y);
    assert.equal((await state()).now, after.now, "the key is let go");
    await visit.close();
  });
});

test("two parameters are varied with given seeds", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(`${url}/#/new?purpose=study`);
    // The page may validate the form while a list is unfinished.
    visit.refusals = [422];
    const { page } = visit;
    for (const [title, list] of [["Friction", "0.2, 0.3"], ["Lumen gap", "26, 30, 34"]] as const) {
      await page.getByRole("combobox", { name: /^Vary/ }).selectOption({ label: title });
      await page.getByRole("combobox", { name: `Values of ${title}` }).selectOption("list");
      await page.getByRole("textbox", { name: `List of values of ${title}` }).fill(list);
    }
    await page.getByRole("combobox", { name: "Seeds", exact: true }).selectOption({ label: "These" });
    await page.getByRole("textbox", { name: /^Seeds of each point/ }).fill("3..4, 9");
    const sent = page.waitForRequest((request) => request.method() === "POST" && request.url() === `${url}/batches`);
    await page.getByRole("button", { name: "Grow 18 models" }).click();
    const { seeds, vary } = (await sent).postDataJSON();
    assert.deepEqual(seeds, [3, 4, 9]);
    assert.deepEqual(vary, { design: "grid", values: { "/friction": [0.2, 0.3], "/collision/gap_um": [26, 30, 34] } });
    await page.waitForURL("**#/batches/*");
    const service = new Oviduct(url);
    const { batches } = await service.listBatchesPage();
    const { columns, rows } = await service.table(batches[0]!.id);
    const cells = ["seed", "/friction", "/collision/gap_um"].map((name) => columns.indexOf(name));
    assert.equal(new Set(rows.map((row) => cells.map((at) => row[at]).join())).size, 18);
    await visit.close();
  });
});

test("a study is requested and its models are counted before", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(`${url}/#/new`);
    // The page may validate the form while a list is unfinished.
    visit.refusals = [422];
    const { page } = visit;
    await page.getByRole("radio", { name: "Study" }).check({ force: true });
    await page.getByRole("combobox", { name: /Vary/ }).selectOption({ label: "Friction" });
    await page.getByRole("button", { name: /^Grow \d+ models$/ }).waitFor();
    await visit.accessible();
    const models = Number(/\d+/.exec((await page.getByRole("button", { name: /^Grow \d+ models$/ }).textContent())!)![0]);
    await page.getByRole("button", { name: /^Grow \d+ models$/ }).click();
    await page.waitForURL("**#/batches/*");
    const { batches } = await new Oviduct(url).listBatchesPage();
    assert.equal(batches[0]!.counts.total, models);
    await visit.close();
  });
});

test("a full queue is said beside the button", async () => {
  await withService(["--cpu-workers", "0", "--queue-limit", "1"], async ({ url }) => {
    await new Oviduct(url).submit({ seed: 1 });
    const visit = await Visit.open(`${url}/#/new`);
    visit.refusals = [429];
    const { page } = visit;
    await page.getByText("No worker").first().waitFor();
    await page.getByRole("button", { name: "Grow the model" }).click();
    await page.getByRole("complementary", { name: "Cost and submission" }).getByRole("alert").waitFor();
    assert.equal(new URL(page.url()).hash.startsWith("#/new"), true);
    await visit.close();
  });
});

test("links open the form that they name, and keep what was filled in", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(`${url}/#/batches`);
    const { page } = visit;
    await page.getByRole("link", { name: "New study" }).click();
    await page.getByRole("heading", { level: 1, name: "New study" }).waitFor();
    await page.waitForFunction(() => document.title.startsWith("New study"));
    // Unfinished text must survive a reload.
    await page.getByRole("combobox", { name: "Seeds", exact: true }).selectOption({ label: "These" });
    const seeds = page.getByRole("textbox", { name: "Seeds", exact: true });
    await seeds.fill("9007199254740990..9007199254740999");
    await page.reload();
    await page.getByText(/exceeds 9007199254740991, the greatest seed\.$/).waitFor();
    assert.equal(await seeds.getAttribute("aria-invalid"), "true");
    await page.getByRole("link", { name: "New model" }).click();
    await page.getByRole("heading", { level: 1, name: "New model" }).waitFor();
    // Change the URL immediately, like a second link, before the form has removed the first one's
    // query.
    await page.evaluate(() => (location.hash = "#/new?purpose=study"));
    await page.getByRole("heading", { level: 1, name: "New study" }).waitFor();
    assert.equal(await seeds.inputValue(), "9007199254740990..9007199254740999");
    await visit.close();
  });
});

test("a request is changed with its seed, and what is typed meanwhile is kept", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const { id } = await new Oviduct(url).submit({ seed: 42, labels: { lab: "a" } });
    const visit = await Visit.open(`${url}/#/new?from=${id}`);
    const { page } = visit;
    const seed = page.getByRole("textbox", { name: "Seed", exact: true });
    await page.getByText(`Filled in from the model ${id}`).waitFor();
    assert.equal(await seed.inputValue(), "42");

    await page.getByRole("button", { name: "Start over" }).click();
    let answer = () => {};
    const typed = new Promise<void>((resolve) => (answer = resolve));
    await page.route(`**/models/${id}`, async (route) => {
      await typed;
      await route.continue().catch(() => undefined);
    });
    const asked = page.waitForRequest(`**/models/${id}`);
    await page.goto(`${url}/#/new?from=${id}`);
    const given = await asked;
    await seed.fill("7");
    answer();
    await page.waitForTimeout(500);
    assert.equal(await seed.inputValue(), "7");
    assert.match(given.failure()?.errorText ?? "", /ERR_ABORTED/);
    await visit.close();
  });
});
