// Exploring a bent model along its centre line.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import type { PNG } from "pngjs";
import { Oviduct, type Model } from "../../../clients/typescript/src/index.ts";
import { Service, SMALL } from "../../../clients/typescript/test/service.ts";
import { contains, nearest, type Outline } from "../../src/explore/contours.ts";
import { FIELD } from "../../src/explore/framing.ts";
import { canvasOf, closeBrowser, colours, difference, picture, settled, shown, Visit } from "./browser.ts";

/** RGB of tissue that is cut across and lengthwise. */
const [TISSUE, SHADED_TISSUE] = [[0xde, 0x95, 0xa9], [0xd2, 0x87, 0x9c]] as const;

let service: Service;
let client: Oviduct;
let [bent, straight]: [Model, Model] = [undefined!, undefined!];

before(async () => {
  service = await Service.start();
  client = new Oviduct(service.url);
  const grow = async (course: object) => {
    const { id } = await client.submit({ preset: "pig", seed: 1, spec: { ...SMALL.spec, length_mm: 20, course } });
    return client.wait(id);
  };
  [bent, straight] = [await grow({ shape: "arc", turn_deg: 120 }), await grow({})];
  assert.deepEqual([bent.status, straight.status], ["succeeded", "succeeded"]);
});
after(async () => {
  await closeBrowser();
  await service?.[Symbol.asyncDispose]();
});

async function open(query = "", model = bent): Promise<Visit> {
  const visit = await Visit.open(`${service.url}/#/models/${model.id}${query}`);
  await canvasOf(visit.page).waitFor();
  await visit.page.getByText(/triangles are shown/).waitFor();
  return visit;
}

function share({ data, width, height }: PNG, color: readonly number[]): number {
  let count = 0;
  for (let i = 0; i < data.length; i += 4) if (color.every((value, k) => Math.abs(data[i + k]! - value) <= 2)) count++;
  return count / (width * height);
}

test("a bent model is seen, cut and flown through along its centre line", async () => {
  const visit = await open();
  const { page } = visit;
  await page.getByText("The tube follows a centre line of tortuosity 1.21 with ends 16.5 mm apart.").waitFor();
  const whole = await shown(page);
  assert(colours(whole) > 200, `${colours(whole)} colours`);
  await page.getByRole("checkbox", { name: "Lengthwise" }).check();
  await page.getByText("Both follow the centre line of the tube.").waitFor();
  const opened = await shown(page);
  assert(share(whole, SHADED_TISSUE) < 0.001 && share(opened, SHADED_TISSUE) > 0.05, `${share(opened, SHADED_TISSUE)} of the picture is cut`);
  await visit.accessible();
  await page.getByRole("checkbox", { name: "Outer wall translucent" }).check();
  assert(share(await shown(page), SHADED_TISSUE) > 0.05, "also if the wall is translucent");
  await page.getByRole("checkbox", { name: "Outer wall translucent" }).uncheck();
  await page.getByRole("checkbox", { name: "Lengthwise" }).uncheck();
  assert(difference(whole, await shown(page)) < 0.002, "as before");

  await page.getByRole("checkbox", { name: "Plane of the section" }).check();
  // The plane is translucent, with a border.
  const glass = difference(whole, await shown(page));
  assert(glass > 0.001, `the plane of the section: ${glass}`);
  await page.getByRole("checkbox", { name: "Plane of the section" }).uncheck();

  await page.getByRole("button", { name: "Fly from the isthmus" }).click();
  const inside = await shown(page);
  assert(colours(inside) > 50, `${colours(inside)} colours`);
  await page.getByRole("slider", { name: "Along the tube" }).fill("0.99");
  assert(difference(inside, await shown(page)) > 0.1, "further on");
  await visit.close();
});

test("a cut across a bent tube shows the section of that place, across the centre line", async () => {
  const at = 0.75;
  const { points } = await client.course(bent.id);
  const { position_mm, tangent } = points[Math.round(at * (points.length - 1))]!;
  const place = points[Math.round(at * (points.length - 1))]!.s_mm;
  const { rings } = await client.cut(bent.id, { z_um: 1000 * place });
  const outlines = rings.map(({ points }): Outline => ({ x: points.map(([u]) => u!), y: points.map(([, v]) => v!) }));
  const half = Math.max(...outlines.flatMap(({ x, y }) => [...Array.from(x), ...Array.from(y)]).map(Math.abs));
  // Look from beyond the end along the centre line, which lies in the plane y = 0. Then u points
  // right and v up.
  const slope = Math.tan(((FIELD / 2) * Math.PI) / 180);
  const distance = (1.1 * half) / slope;
  const azimuth = (Math.atan2(tangent[0]!, tangent[2]!) * 180) / Math.PI;
  const [x, y, z] = position_mm as [number, number, number];
  const visit = await open(`?cam=${azimuth}_0_${distance / 1000}_${x}_${y}_${z / 20}&cut=${place / 20}`);
  await visit.page.getByRole("button", { name: /^Full/ }).click();
  await visit.page.getByRole("button", { name: /^Full/, pressed: true }).waitFor();
  const { width, height, data } = await shown(visit.page);
  const pixel = (2 * distance * slope) / height;
  const margin = 6 + 2 * pixel;
  const wrong: string[] = [];
  const samples = { tissue: 0, free: 0 };
  for (let row = 1; row < height; row += 2) {
    for (let column = 1; column < width; column += 2) {
      const [u, v] = [(column + 0.5 - width / 2) * pixel, (height / 2 - row - 0.5) * pixel];
      // Beyond the cut, the side of the tube is visible.
      if (Math.hypot(u, v) > half || outlines.some((outline) => nearest(outline, u, v).distance < margin)) continue;
      const inTissue = outlines.filter((outline) => contains(outline, u, v)).length % 2 === 1;
      const i = 4 * (row * width + column);
      const painted = TISSUE.every((value, channel) => Math.abs(data[i + channel]! - value) <= 2);
      samples[inTissue ? "tissue" : "free"]++;
      if (painted !== inTissue) wrong.push(`${u.toFixed(0)}, ${v.toFixed(0)} µm`);
    }
  }
  assert(samples.tissue > 5000 && samples.free > 100, JSON.stringify(samples));
  assert.deepEqual(wrong.slice(0, 10), []);
  await visit.close();
});

test("points that are picked on a bent model are where the file has them", async () => {
  const visit = await open("?cam=ampulla");
  const { page } = visit;
  await settled(page);
  await page.getByRole("button", { name: "Pick two points" }).click();
  const box = (await canvasOf(page).boundingBox())!;
  for (const right of [-0.11, 0.11]) await page.mouse.click(box.x + (0.5 + right) * box.width, box.y + 0.5 * box.height);
  await page.getByText("Enter coordinates").click();
  const { position_mm: end, tangent } = (await client.course(bent.id)).points.at(-1)!;
  const spots = [];
  for (const name of ["A", "B"]) {
    const spot = [];
    for (const axis of ["x", "y", "z"]) spot.push(Number(await page.getByRole("spinbutton", { name: `${name} ${axis}, mm` }).inputValue()));
    spots.push(spot);
    // The face of the ampulla is perpendicular to the centre line.
    const ahead = spot.reduce((sum, value, k) => sum + (value - end[k]!) * tangent[k]!, 0);
    assert(Math.abs(ahead) < 0.01, `${ahead} mm before the end`);
  }
  const [a, b] = spots as [number[], number[]];
  const distance = 1000 * Math.hypot(...a.map((value, k) => value - b[k]!));
  const text = (await page.getByRole("region", { name: "Measure a distance" }).getByRole("status").textContent())!;
  const [, number, unit] = /Distance ([\d.,]+) (µm|mm)/.exec(text)!;
  assert(Math.abs(Number(number!.replace(",", "")) * (unit === "mm" ? 1000 : 1) / distance - 1) < 0.01, `${text}, and not ${distance} µm`);
  await visit.close();
});

test("a straight model asks for no course", async () => {
  const visit = await Visit.open(service.url);
  const { page } = visit;
  const asked: string[] = [];
  page.on("request", (request) => /\/course$/.test(request.url()) && asked.push(request.url()));
  await page.goto(`${service.url}/#/models/${straight.id}`);
  await page.getByText(/triangles are shown/).waitFor();
  assert.deepEqual(asked, []);
  await page.goto(`${service.url}/#/models/${bent.id}`);
  await page.getByText(/^The tube follows/).waitFor();
  await page.getByText(/triangles are shown/).waitFor();
  assert.equal(asked.length, 1);
  await visit.close();
});

test("a course that does not come is said, and comes later", async () => {
  const visit = await Visit.open(service.url);
  const { page } = visit;
  visit.away = true;
  let missing = true;
  await page.route("**/course", (route) => (missing ? route.abort() : route.continue()));
  await page.goto(`${service.url}/#/models/${bent.id}`);
  await page.getByRole("heading", { name: "The centre line could not be loaded" }).waitFor();
  missing = false;
  await page.getByRole("button", { name: "Try again" }).click();
  await page.getByText(/triangles are shown/).waitFor();
  await visit.close();
});

test("a bent and a straight model are compared at the same places, each from a place of its own", async () => {
  const visit = await Visit.open(`${service.url}/#/compare/${straight.id}/${bent.id}`);
  const { page } = visit;
  await canvasOf(page).nth(1).waitFor();
  await page.getByText("The tube is straight.").waitFor();
  await page.getByText(/^The tube follows a centre line/).waitFor();
  await page.getByRole("button", { name: "Ampulla" }).click();
  const both = async () => {
    await settled(page);
    return [await picture(canvasOf(page).nth(0)), await picture(canvasOf(page).nth(1))] as const;
  };
  const ends = await both();
  for (const end of ends) assert(share(end, TISSUE) > 0.1, "the face of the ampulla");
  await canvasOf(page).first().focus();
  for (let i = 0; i < 3; i++) await page.keyboard.press("ArrowLeft");
  // Without the focus ring.
  await canvasOf(page).first().blur();
  const turned = await both();
  for (const [k, now] of turned.entries()) assert(difference(ends[k]!, now) > 0.02, `picture ${k + 1} turns`);
  await page.waitForTimeout(800);
  const again = await Visit.open(page.url());
  await canvasOf(again.page).nth(1).waitFor();
  await again.page.getByText(/triangles are shown/).nth(1).waitFor();
  await settled(again.page);
  for (const k of [0, 1]) {
    const differs = difference(turned[k]!, await picture(canvasOf(again.page).nth(k)));
    assert(differs < 0.01, `the link shows the same in picture ${k + 1}: ${differs}`);
  }
  await again.close();
  await visit.close();
});
