// Takes the pictures of the documentation from a live service; see scripts/pictures.
import { mkdirSync } from "node:fs";
import { join } from "node:path";
import type { Locator, Page } from "playwright-core";
import { Oviduct } from "../../clients/typescript/src/index.ts";
import { Service } from "../../clients/typescript/test/service.ts";
import { closeBrowser, Visit } from "../test/page/browser.ts";

/** Folder of the stills, and folder of the frames of the animation. */
const [images, frames] = process.argv.slice(2) as [string, string];
mkdirSync(frames, { recursive: true });

const canvasOf = (page: Page) => page.getByRole("application", { name: /^3D view/ });

async function drawn(page: Page): Promise<void> {
  await canvasOf(page).first().waitFor({ timeout: 300_000 });
  await page.getByText(/triangles are shown/).first().waitFor({ timeout: 120_000 });
  await page.getByText(/^Loading/).first().waitFor({ state: "detached" });
  await page.getByText(/^Looking for the way/).first().waitFor({ state: "detached", timeout: 120_000 });
  await page.waitForTimeout(3000);
}

async function still(page: Page, name: string): Promise<void> {
  await page.screenshot({ path: join(images, `${name}.png`) });
  console.log(name);
}

/** Numbered frames of a part of the page. */
class Film {
  #frame = 0;

  async take(page: Page, part?: Locator): Promise<void> {
    const path = join(frames, `${String(this.#frame++).padStart(4, "0")}.png`);
    await (part ?? page).screenshot({ path });
  }
}

const service = await Service.start();
const client = new Oviduct(service.url);
try {
  // Growth, a turn, a cut and a flight, in the width of a column of the README.
  const film = new Film();
  const visit = await Visit.open(service.url, { viewport: { width: 900, height: 640 }, reducedMotion: "no-preference" });
  const { page } = visit;
  await film.take(page);
  const { id } = await client.submit({ preset: "pig", seed: 7 });
  await page.goto(`${service.url}/#/models/${id}`);
  const finished = canvasOf(page);
  while (!(await finished.isVisible())) {
    await film.take(page);
    await page.waitForTimeout(120);
  }
  await drawn(page);
  for (const query of turn()) {
    await page.goto(`${service.url}/#/models/${id}?${query}`);
    await page.reload();
    await drawn(page);
    await film.take(page);
  }
  await visit.close();

  const second = await client.submit({ preset: "pig", seed: 8 }, { wait: 60 });
  await client.wait(second.id);
  const desk = await Visit.open(`${service.url}/#/models/${id}?open=20`, { viewport: { width: 1440, height: 1400 } });
  await drawn(desk.page);
  await still(desk.page, "console-explore");
  await desk.page.setViewportSize({ width: 1440, height: 900 });
  await desk.page.goto(`${service.url}/#/new`);
  await desk.page.getByRole("button", { name: "Grow the model" }).waitFor();
  await desk.page.waitForTimeout(1500);
  await still(desk.page, "console-request");
  await desk.page.goto(`${service.url}/#/compare/${id}/${second.id}?cam=ampulla`);
  await drawn(desk.page);
  await still(desk.page, "console-compare");
  await desk.page.goto(`${service.url}/#/`);
  await desk.page.waitForTimeout(2500);
  await still(desk.page, "console-list");
  await desk.close();

  const phone = await Visit.open(`${service.url}/#/models/${id}?cam=ampulla`, { viewport: { width: 390, height: 844 }, colorScheme: "dark" });
  await drawn(phone.page);
  await still(phone.page, "console-phone");
  await phone.close();
} finally {
  await closeBrowser();
  await service[Symbol.asyncDispose]();
}

/** Queries of the views in the animation. */
function* turn(): Generator<string> {
  for (let angle = -40; angle <= 60; angle += 10) yield `open=${angle}`;
  for (let at = 0.95; at >= 0.3; at -= 0.05) yield `cam=ampulla&cut=${at.toFixed(2)}`;
  for (let at = 0.2; at <= 0.9; at += 0.02) yield `fly=${at.toFixed(2)}`;
}
