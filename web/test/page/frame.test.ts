// The frame of all pages: navigation, theme, connection.
import assert from "node:assert/strict";
import { after, test } from "node:test";
import { Oviduct } from "../../../clients/typescript/src/index.ts";
import { SMALL, withService } from "../../../clients/typescript/test/service.ts";
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

test("addresses that are none say so, and a new study is one", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(`${url}/#/__proto__`);
    const { page } = visit;
    await page.getByRole("heading", { name: "There is no such page" }).waitFor();
    await page.goto(`${url}/#/constructor`);
    await page.getByRole("heading", { name: "There is no such page" }).waitFor();
    await page.getByRole("link", { name: "Studies" }).click();
    await page.getByRole("link", { name: "New study" }).click();
    await page.getByRole("heading", { level: 1, name: "New study" }).waitFor();
    await page.getByRole("link", { name: "New model" }).click();
    await page.getByRole("heading", { level: 1, name: "New model" }).waitFor();
    await visit.close();
  });
});

test("the theme is chosen, and kept", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(url, { colorScheme: "dark" });
    const { page } = visit;
    const theme = async (name: string, ground: string) => {
      await page.getByRole("button", { name: `Theme: ${name}`, exact: true }).waitFor();
      // The change is not immediate: reduced motion shortens transitions but does not remove them.
      await page.waitForFunction((ground) => getComputedStyle(document.body).backgroundColor === ground, ground);
    };
    const next = () => page.getByRole("button", { name: /^Theme/ }).click();
    const [light, dark] = ["rgb(251, 248, 247)", "rgb(23, 19, 22)"];
    await theme("as the system", dark);
    await next();
    await theme("light", light);
    await visit.accessible();
    await page.reload();
    await theme("light", light);
    await next();
    await theme("dark", dark);
    await next();
    await page.emulateMedia({ colorScheme: "light" });
    await theme("as the system", light);
    await visit.close();
  });
});

test("a hidden page closes its stream, and catches up when it is seen again", async () => {
  await withService(["--cpu-workers", "0"], async (service) => {
    const visit = await Visit.open(service.url);
    const { page } = visit;
    await page.getByRole("img", { name: /^Connected/ }).waitFor();
    const show = (hidden: boolean) =>
      page.evaluate((hidden) => {
        Object.defineProperty(document, "hidden", { value: hidden, configurable: true });
        document.dispatchEvent(new Event("visibilitychange"));
      }, hidden);
    const closed = page.waitForEvent("requestfailed", (request) => request.url().includes("/events"));
    await show(true);
    await closed;
    await new Oviduct(service.url).submit({ ...SMALL, seed: 5 });
    const opened = page.waitForRequest((request) => /\/events\?.*last_event_id=/.test(request.url()));
    await show(false);
    await opened;
    await page.getByRole("listitem", { name: "Pig oviduct, seed 5" }).waitFor();
    await visit.close();
  });
});

test("text is copied also where the page is not secure", async () => {
  await withService([], async (service) => {
    const { id } = await new Oviduct(service.url).submit({ ...SMALL, seed: 6 }, { wait: 60 });
    const context = { permissions: ["clipboard-read"] };
    const visit = await Visit.open(`${service.url}/#/models/${id}`, context);
    const { page } = visit;
    // Insecure pages have no clipboard.
    const read = await page.evaluateHandle(() => {
      const read = navigator.clipboard.readText.bind(navigator.clipboard);
      Object.defineProperty(navigator, "clipboard", { value: undefined });
      return read;
    });
    await page.getByText(/triangles are shown/).waitFor();
    await page.getByRole("checkbox", { name: "Lengthwise" }).check();
    await page.getByRole("button", { name: "Copy link" }).click();
    await page.getByText("Copied.").waitFor();
    const copied = await read.evaluate((read) => read());
    assert.match(copied, /open=/, "the link is that of what is shown");
    assert.equal(copied, page.url());
    await visit.close();
  });
});

test("a page whose code does not come is loaded again as a whole", async () => {
  await withService(["--cpu-workers", "0"], async ({ url }) => {
    const visit = await Visit.open(url);
    const { page } = visit;
    await page.getByRole("heading", { level: 1 }).waitFor();
    visit.away = true;
    await page.route("**/assets/page-*.js", (route) => route.abort());
    await page.getByRole("link", { name: "Studies" }).click();
    await page.getByText("This page could not be loaded").waitFor();
    await page.unroute("**/assets/page-*.js");
    await page.getByRole("button", { name: "Reload the page" }).click();
    await page.getByRole("heading", { level: 1, name: "Studies" }).waitFor();
    visit.away = false;
    await visit.close();
  });
});
