// Places of the page: under a prefix of a proxy, and at a plain http:// name, where browsers
// withhold some features.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFile } from "node:fs/promises";
import { after, test } from "node:test";
import { Oviduct } from "../../../clients/typescript/src/index.ts";
import { proxy, SMALL, withServer, withService } from "../../../clients/typescript/test/service.ts";
import { closeBrowser, colours, picture, Visit } from "./browser.ts";

after(closeBrowser);

/**
 * Goes from the list through the form to a new model, its picture and one of its files.
 *
 * `home` is the URL of the page.
 */
async function grow(visit: Visit, home: string, service: string): Promise<void> {
  const { page } = visit;
  await page.getByRole("link", { name: "New model" }).first().click();
  await page.getByRole("textbox", { name: "Seed", exact: true }).fill("11");
  await page.getByRole("textbox", { name: /^Time steps/ }).fill("200");
  await page.getByRole("button", { name: "Grow the model" }).click();
  await page.waitForURL(`${home}#/models/*`);
  const canvas = page.getByRole("application", { name: /^3D view/ });
  await canvas.waitFor({ timeout: 240_000 });
  await page.getByText(/triangles are shown/).waitFor();
  await page.waitForFunction(() => Number(document.querySelector<HTMLElement>("canvas[data-frames]")?.dataset["frames"]) > 0);
  assert(colours(await picture(canvas)) > 200);

  const id = /[\da-f-]{36}/.exec(page.url())![0];
  const report = (await new Oviduct(service).get(id)).files.find(({ name }) => name === "report.json")!;
  const downloaded = page.waitForEvent("download");
  await page.getByRole("button", { name: "Download report.json" }).click();
  const bytes = await readFile(await (await downloaded).path());
  assert.equal(createHash("sha256").update(bytes).digest("hex"), report.sha256);

  assert.equal(await page.getByRole("link", { name: "Report as a page" }).getAttribute("href"), `${home}models/${id}/report.html`);

  await page.getByRole("link", { name: "Models", exact: true }).click();
  await page.getByRole("listitem", { name: "Pig oviduct, seed 11" }).getByText("succeeded").waitFor();
  // The picture is loaded from the service.
  await page.getByRole("listitem", { name: "Pig oviduct, seed 11" }).locator("img").waitFor();
}

test("everything works under the prefix of a proxy", async () => {
  await withService([], async ({ url }) => {
    await new Oviduct(url).submit({ ...SMALL, seed: 10 });
    await withServer(proxy("/lab/oviduct", url), async (outside) => {
      const home = `${outside}/lab/oviduct/`;
      const visit = await Visit.open(home);
      const { page } = visit;
      const strays: string[] = [];
      page.on("request", (request) => {
        if (!/^(blob|data):/.test(request.url()) && !request.url().startsWith(home)) strays.push(request.url());
      });
      await page.getByRole("listitem", { name: "Pig oviduct, seed 10" }).waitFor();
      await grow(visit, home, url);
      assert.deepEqual(strays, []);
      await visit.close();
    });
  });
});

test("everything works at a plain http:// name, and text is copied", async () => {
  await withService(["--insecure-no-auth"], async ({ url }) => {
    const model = await new Oviduct(url).submit({ ...SMALL, seed: 10 }, { wait: 60 });
    const home = `${url.replace("127.0.0.1", "lab.example")}/`;
    const visit = await Visit.open(home);
    const { page } = visit;
    assert.equal(await page.evaluate(() => isSecureContext), false);
    await page.getByRole("listitem", { name: "Pig oviduct, seed 10" }).waitFor();
    await grow(visit, home, url);

    const copied = async (copy: () => Promise<void>) => {
      await copy();
      await page.getByText("Copied.").last().waitFor();
      const link = page.url();
      await page.getByRole("link", { name: "Models", exact: true }).click();
      const field = page.getByRole("searchbox", { name: /^Label/ });
      await field.focus();
      await page.keyboard.press("Control+V");
      const text = await field.inputValue();
      await page.goto(link);
      return text;
    };
    await page.goto(`${home}#/models/${model.id}`);
    const link = await copied(() => page.getByRole("button", { name: "Copy link" }).click());
    assert(link.startsWith(`${home}#/models/${model.id}`), link);
    const report = model.files.find(({ name }) => name === "report.json")!;
    const digest = await copied(async () => {
      const file = page.locator("li").filter({ has: page.getByText("report.json", { exact: true }) });
      await file.getByText("SHA-256", { exact: true }).click();
      await file.getByRole("button", { name: "Copy" }).click();
    });
    assert.equal(digest, report.sha256);
    await page.goto(`${home}#/new?preset=pig&seed=3`);
    const code = await copied(async () => {
      await page.getByText("The same request as code").click();
      await page.getByRole("tab", { name: "JSON" }).click();
      await page.getByRole("button", { name: "Copy" }).click();
    });
    assert.deepEqual(JSON.parse(code), { preset: "pig", seed: 3 });
    await visit.close();
  });
});
