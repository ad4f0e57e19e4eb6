// The frame of all pages: navigation, theme, key.
import assert from "node:assert/strict";
import { after, test } from "node:test";
import { withService } from "../../../clients/typescript/test/service.ts";
import { closeBrowser, Visit } from "./browser.ts";

after(closeBrowser);

test("pages are reached by keyboard alone", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(url);
    const { page } = visit;
    await page.getByRole("heading", { level: 1 }).waitFor();
    await page.keyboard.press("Tab");
    assert.equal(await page.evaluate(() => document.activeElement?.textContent), "Skip to content");
    for (let i = 0; i < 3; i++) await page.keyboard.press("Tab");
    await page.keyboard.press("Enter");
    await page.waitForURL("**#/batches");
    await visit.accessible();
    await visit.close();
  });
});
