// A contracting model in the browser.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import type { Page } from "playwright-core";
import { Oviduct, type Model } from "../../../clients/typescript/src/index.ts";
import { Service, SMALL } from "../../../clients/typescript/test/service.ts";
import { canvasOf, closeBrowser, difference, shown, Visit } from "./browser.ts";

let service: Service;
let client: Oviduct;
let [contracting, resting]: [Model, Model] = [undefined!, undefined!];

before(async () => {
  service = await Service.start();
  client = new Oviduct(service.url);
  const grow = async (spec: object) => {
    const { id } = await client.submit({ preset: "paper", seed: 1, spec: { ...SMALL.spec, length_mm: 20, ...spec } });
    return client.wait(id);
  };
  const contraction = { frames: 4, closure: 0.8, wavelength_mm: 8 };
  [contracting, resting] = [await grow({ contraction, course: { shape: "arc", turn_deg: 40 } }), await grow({})];
  assert.deepEqual([contracting.status, resting.status], ["succeeded", "succeeded"]);
});
after(async () => {
  await closeBrowser();
  await service?.[Symbol.asyncDispose]();
});

const panelOf = (page: Page) => page.getByRole("region", { name: "Contraction" });

async function open(query = "", model = contracting, options = {}): Promise<Visit> {
  const visit = await Visit.open(`${service.url}/#/models/${model.id}${query}`, options);
  await canvasOf(visit.page).waitFor();
  await visit.page.getByText(/triangles(,| are shown)/).first().waitFor();
  return visit;
}

test("a contraction is played, stopped and sought, and the tube at rest comes back", async () => {
  // Cut across and seen along the tube, so that the lumen is visible.
  const visit = await open("?cam=ampulla&cut=0.5", contracting, { reducedMotion: "no-preference" });
  const { page } = visit;
  for (let i = 0; i < 8; i++) await canvasOf(page).press("+");
  // Without the focus ring.
  await canvasOf(page).blur();
  const rest = await shown(page);
  await panelOf(page).getByRole("button", { name: /^Play the contraction/ }).click();
  await panelOf(page).getByRole("button", { name: "Pause the contraction" }).waitFor();
  const time = panelOf(page).getByRole("slider", { name: "Time" });
  for (const frame of ["Frame 2", "Frame 4", "Frame 1"]) await panelOf(page).getByText(`${frame} of 4`).waitFor();
  await panelOf(page).getByRole("button", { name: "Pause the contraction" }).click();
  await page.getByText("The contraction has one level of detail; these are of the tube at rest.").waitFor();
  assert(await page.getByRole("button", { name: /^Light/ }).isDisabled());

  await time.fill("0");
  const first = await shown(page);
  await time.fill("0.5");
  await panelOf(page).getByText("Frame 3 of 4 · 2.00 s").waitFor();
  const third = await shown(page);
  await page.waitForURL(/phase=0.5/);
  const link = page.url();
  assert(difference(first, third) > 0.005, `${difference(first, third)} of the picture moved`);
  await visit.accessible();

  await panelOf(page).getByRole("button", { name: "Show at rest" }).click();
  await page.getByText(/triangles are shown/).waitFor();
  assert(difference(await shown(page), rest) < 0.001);
  await page.waitForURL((url) => !url.hash.includes("phase"));
  await visit.close();

  // The link opens the same frame.
  const again = await open(link.slice(link.indexOf("?")));
  await panelOf(again.page).getByText("Frame 3 of 4 · 2.00 s").waitFor();
  await panelOf(again.page).getByRole("button", { name: "Play the contraction" }).waitFor();
  assert(difference(await shown(again.page), third) < 0.002);
  await again.close();
});

test("with less motion it waits for Play, and a model at rest has nothing to play", async () => {
  const visit = await open();
  await panelOf(visit.page).getByRole("button", { name: /^Play the contraction/ }).click();
  await panelOf(visit.page).getByText("Play moves the tube; it does not start by itself.").waitFor();
  await panelOf(visit.page).getByText("Frame 1 of 4 · 0.00 s").waitFor();
  await visit.close();
  const still = await open("?phase=0.5", resting);
  assert.equal(await panelOf(still.page).count(), 0);
  await still.close();
});

test("an animation that does not come is asked for again", async () => {
  const visit = await open();
  const { page } = visit;
  await page.route("**/animation.glb*", (route) => route.abort());
  visit.away = true;
  await panelOf(page).getByRole("button", { name: /^Play the contraction/ }).click();
  await panelOf(page).getByText(/^The animation could not be loaded/).waitFor();
  await page.unroute("**/animation.glb*");
  await panelOf(page).getByRole("button", { name: "Try again" }).click();
  await panelOf(page).getByText("Frame 1 of 4 · 0.00 s").waitFor();
  await visit.close();
});
