// Services with API keys.
import assert from "node:assert/strict";
import { after, test } from "node:test";
import { Oviduct } from "../../../clients/typescript/src/index.ts";
import { SMALL, withService } from "../../../clients/typescript/test/service.ts";
import { closeBrowser, Visit } from "./browser.ts";

after(closeBrowser);

test("a key is asked for once, kept in the tab, and opens everything", async () => {
  await withService([], async (service) => {
    const key = await service.key();
    const { id } = await new Oviduct(service.url, { key }).submit({ ...SMALL, seed: 3 }, { wait: 60 });
    const visit = await Visit.open(`${service.url}/#/models/${id}`, {}, [401]);
    const { page } = visit;
    const addresses: string[] = [];
    page.on("request", (request) => addresses.push(request.url()));
    const dialog = page.getByRole("dialog", { name: "Key" });
    await dialog.getByLabel("Key of this service").fill("wrong");
    await visit.accessible();
    await dialog.getByRole("button", { name: "Use this key" }).click();
    await dialog.getByRole("alert").waitFor();
    await dialog.getByLabel("Key of this service").fill(key);
    await dialog.getByRole("button", { name: "Use this key" }).click();
    await dialog.waitFor({ state: "detached" });
    visit.refusals = [];
    const canvas = page.getByRole("application", { name: /^3D view/ });
    await canvas.waitFor();
    await page.waitForFunction(() => Number(document.querySelector<HTMLElement>("canvas[data-frames]")?.dataset["frames"]) > 0);

    await page.reload();
    await canvas.waitFor();
    const kept = await page.evaluate(() => [JSON.stringify({ ...sessionStorage }), JSON.stringify({ ...localStorage }), document.cookie]);
    assert.deepEqual(kept.map((text) => text.includes(key)), [true, false, false]);
    assert(!addresses.some((address) => address.includes(key)), "the key is in an address");

    const downloaded = page.waitForEvent("download");
    await page.getByRole("button", { name: "Download report.json" }).or(page.getByRole("link", { name: "Download report.json" })).click();
    assert.equal(await (await downloaded).failure(), null);

    // The URL of the report page contains a ticket.
    const opened = page.waitForEvent("popup");
    await page.getByRole("button", { name: "Report as a page" }).click();
    const report = await opened;
    await report.getByRole("heading", { name: /^Pig oviduct, seed 3/ }).waitFor();
    assert.match(report.url(), /\/models\/[\da-f-]+\/report\.html\?ticket=/);
    await report.close();

    // Another tab does not know the API key.
    const other = await Visit.open(service.url, {}, [401]);
    await other.page.getByRole("dialog", { name: "Key" }).waitFor();
    await other.close();
    await page.getByRole("button", { name: "Change or forget the key" }).click();
    visit.refusals = [401];
    await page.getByRole("button", { name: "Forget the key", exact: true }).click();
    await page.getByText("This service asks for a key").waitFor();
    await visit.close();
  });
});

test("a dialog of the key that was put aside is opened again", async () => {
  await withService(["--cpu-workers", "0"], async (service) => {
    const key = await service.key();
    const visit = await Visit.open(service.url, {}, [401]);
    const { page } = visit;
    const dialog = page.getByRole("dialog", { name: "Key" });
    for (const part of ["main", "banner"] as const) {
      await dialog.waitFor();
      await page.keyboard.press("Escape");
      // The dialog is closed before it is removed.
      await page.locator("dialog").waitFor({ state: "detached" });
      await page.getByRole(part).getByRole("button", { name: "Enter a key" }).click();
    }
    await visit.accessible();
    await dialog.getByLabel("Key of this service").fill(key);
    await dialog.getByRole("button", { name: "Use this key" }).click();
    await page.getByRole("heading", { name: "Grow your first model" }).waitFor();
    await dialog.waitFor({ state: "detached" });
    await visit.close();
  });
});

test("a key that may not read is told so", async () => {
  await withService(["--cpu-workers", "0"], async (service) => {
    const key = await service.key("--scopes", "submit");
    const visit = await Visit.open(service.url, {}, [401, 403]);
    const { page } = visit;
    await page.evaluate((key) => sessionStorage.setItem("oviduct-key", key), key);
    await page.reload();
    await page.getByText(/^This key does not allow that\..* What you see is what was known last/).waitFor();
    assert.equal(await page.getByText("The service does not answer").count(), 0);
    // Links contain no API key.
    assert.equal(await page.getByRole("contentinfo").getByRole("link", { name: /OpenAPI|Presets/ }).count(), 0);
    await visit.close();
  });
});
