// The flight: through the lumen, with the cut at its place, and what it says while it cannot begin.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import type { Page } from "playwright-core";
import type { PNG } from "pngjs";
import { Oviduct, type Cut, type Model } from "../../../clients/typescript/src/index.ts";
import { Service, SMALL } from "../../../clients/typescript/test/service.ts";
import { contains } from "../../src/explore/contours.ts";
import { OUTSIDE_DARK } from "../../src/explore/viewer/dark.ts";
import { canvasOf, closeBrowser, colours, difference, shown, Visit } from "./browser.ts";

let service: Service;
let client: Oviduct;
/** A straight model whose surface leans, and a bent one. */
let [leaning, bent]: [Model, Model] = [undefined!, undefined!];

before(async () => {
  service = await Service.start();
  client = new Oviduct(service.url);
  const grow = async (preset: string, spec: object) => client.wait((await client.submit({ preset, seed: 3, spec })).id);
  leaning = await grow("paper", { steps: 400, length_mm: 20, sway: { strength: 5 }, lean: { strength_um: 650 } });
  bent = await grow("pig", { ...SMALL.spec, length_mm: 20, course: { shape: "arc", turn_deg: 120 } });
  assert.deepEqual([leaning.status, bent.status], ["succeeded", "succeeded"]);
});
after(async () => {
  await closeBrowser();
  await service?.[Symbol.asyncDispose]();
});

const inset = (page: Page) => page.getByRole("button", { name: /^Show the cross section at/ });
const note = (page: Page) => page.getByRole("region", { name: "Model in 3D" }).getByRole("status");

/** Places of a flight. */
const PLACES = Array.from({ length: 20 }, (_, k) => 0.05 + (0.9 * k) / 19);
/** Place from which the open end, beyond which there is nothing to see, may be in sight. */
const NEAR_END = 0.7;

/** True if a point of a cut, micrometres, is in the lumen. */
function isInLumen({ rings }: Cut, x: number, y: number): boolean {
  const around = rings.filter(({ points }) => {
    return contains({ x: points.map(([u]) => u!), y: points.map(([, v]) => v!) }, x, y);
  });
  return around.some(({ kind }) => kind === "lumen" || kind === "pocket") && around.length % 2 === 0;
}

/** A camera in a wall sees thousands of pixels of background; the renderer misses a few at edges. */
const FEW = 20;

/** Number of pixels that show nothing. */
function empty({ data, width, height }: PNG): number {
  let count = 0;
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const i = 4 * (row * width + column);
      if (((data[i]! << 16) | (data[i + 1]! << 8) | data[i + 2]!) === OUTSIDE_DARK) count++;
    }
  }
  return count;
}

for (const which of ["leaning", "bent"] as const) {
  test(`a flight through a ${which} model stays in its lumen and sees nothing but its walls`, async () => {
    const model = which === "bent" ? bent : leaning;
    const visit = await Visit.open(`${service.url}/#/models/${model.id}?fly=${PLACES[0]}`);
    const { page } = visit;
    const slider = page.getByRole("slider", { name: "Along the tube" });
    const length = (await client.report(model.id)).spec.length_mm as number;
    let last: PNG | undefined;
    for (const place of PLACES) {
      await slider.fill(String(place));
      const z_um = 1000 * place * length;
      // The slider has steps, and the drawing is that of its place.
      await page.waitForFunction(
        ([z, step]) => {
          const drawn = document.querySelector<SVGElement>(".picture-inset svg")?.dataset["zUm"];
          return Math.abs(Number(drawn) - z!) < step!;
        },
        [z_um, length],
      );
      const picture = await shown(page);
      if (place < NEAR_END) assert(empty(picture) < FEW, `${empty(picture)} pixels of background at ${z_um} µm`);
      assert(colours(picture) > 50, `${colours(picture)} colours at ${z_um} µm`);
      if (last) assert(difference(last, picture) > 0.001, "the camera moves");
      last = picture;
      const drawing = inset(page).locator("svg");
      const at = Number(await drawing.getAttribute("data-z-um"));
      const moved = (await drawing.locator(".inset-camera").getAttribute("transform"))!;
      const [, u, v] = /translate\((\S+) (\S+)\)/.exec(moved)!;
      const cut = await client.cut(model.id, { z_um: at });
      assert(isInLumen(cut, Number(u), Number(v)), `(${u}, ${v}) at ${at} µm is in the tissue`);
    }
    // From the drawing to the cross section of the place.
    await visit.accessible();
    const name = (await inset(page).getAttribute("aria-label"))!;
    await inset(page).click();
    await inset(page).waitFor({ state: "detached" });
    const place = name.replace(/^Show the cross section at /, "");
    await page.getByRole("img", { name: `Cross section at ${place}` }).waitFor();
    await visit.close();
  });
}

test("the flight waits for medium detail, and shows the model from outside until then", async () => {
  const visit = await Visit.open(service.url, {}, [500]);
  const { page } = visit;
  visit.away = true;
  let [answer, missing] = [() => {}, true];
  const held = new Promise<void>((resolve) => (answer = resolve));
  await page.route("**/way", async (route) => (await held, route.continue()));
  await page.route("**/model.lod1.glb*", (route) => (missing ? route.abort() : route.continue()));
  await page.goto(`${service.url}/#/models/${leaning.id}?fly=0.5`);
  await note(page).getByText("Looking for the way through the lumen …").waitFor();
  await page.getByText(/triangles are shown/).waitFor();
  await visit.accessible();
  answer();
  await note(page).getByText("The flight needs medium detail.").waitFor();
  const light = page.getByRole("group", { name: "Level of detail" }).getByRole("button", { name: /^Light/ });
  assert(await light.isDisabled(), "the walls of the lightest level are too far from the surface");
  missing = false;
  await note(page).getByRole("button", { name: "Try again" }).click();
  await note(page).waitFor({ state: "detached" });
  await inset(page).waitFor();
  assert(empty(await shown(page)) < FEW);
  await visit.close();
});

test("if there is no way, or none yet, the picture says why", async () => {
  const visit = await Visit.open(service.url, {}, [404, 503]);
  const { page } = visit;
  let [slug, status] = ["too-many-pictures", 503];
  await page.route("**/way", (route) => {
    const detail = "The lumen is closed at 3.1 mm.";
    const body = JSON.stringify({ type: `urn:oviduct:problem:${slug}`, title: slug, status, detail });
    return route.fulfill({ status, contentType: "application/problem+json", body });
  });
  await page.goto(`${service.url}/#/models/${leaning.id}?fly=0.5`);
  await note(page).getByText("The way could not be loaded. The lumen is closed at 3.1 mm.").waitFor();
  [slug, status] = ["way-not-found", 404];
  await note(page).getByRole("button", { name: "Try again" }).click();
  await note(page).getByText("The lumen is closed at 3.1 mm.", { exact: true }).waitFor();
  assert.equal(await note(page).getByRole("button", { name: "Try again" }).count(), 0);
  await visit.accessible();
  await note(page).getByRole("button", { name: "Leave the flight" }).click();
  await note(page).waitFor({ state: "detached" });
  assert(await page.getByRole("button", { name: "Fly from the isthmus" }).isDisabled());
  await canvasOf(page).focus();
  await page.keyboard.press("ArrowLeft");
  await page.waitForFunction(() => location.hash.includes("cam="));
  await visit.close();
});
