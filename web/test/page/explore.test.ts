// Exploring a finished model: in 3D, by section, by measures, by links.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { after, before, test } from "node:test";
import { PNG } from "pngjs";
import { Oviduct, type Cut, type Model, type ModelRequest } from "../../../clients/typescript/src/index.ts";
import { Service, SMALL } from "../../../clients/typescript/test/service.ts";
import { nearestIndex } from "../../src/explore/ascending.ts";
import { boundsOf, contains, type Outline } from "../../src/explore/contours.ts";
import { FIELD } from "../../src/explore/framing.ts";
import { canvasOf, closeBrowser, colours, difference, picture, settled, shown, Visit } from "./browser.ts";

/** RGB of tissue that is cut across, as in the service's drawings, and lengthwise. */
const [TISSUE, SHADED_TISSUE] = [[0xde, 0x95, 0xa9], [0xd2, 0x87, 0x9c]] as const;

let service: Service;
let client: Oviduct;
/** Models as large as the paper's model. */
let models: [Model, Model];
/** A small model whose surface leans, so that planar cuts of its ampulla have islands. */
let leaning: Model;

/**
 * A thin wall, so that lumen and gaps are large in a picture of a section.
 *
 * The tube is straight, so cuts equal sections.
 */
const THIN: ModelRequest["spec"] = {
  containment: { wall_um: { keys: [[0, 520], [0.125, 520], [0.45, 260], [1, 260]], ease: "smooth" } },
  sway: { strength: 0 },
  lean: { strength_um: 0 },
};

const LEANING: ModelRequest["spec"] = {
  steps: 400,
  length_mm: 20,
  sway: { strength: 5 },
  lean: { strength_um: 650 },
};

before(async () => {
  service = await Service.start();
  client = new Oviduct(service.url);
  const ids = await Promise.all([7, 8].map(async (seed) => (await client.submit({ preset: "pig", seed, spec: THIN })).id));
  models = (await Promise.all(ids.map((id) => client.wait(id)))) as [Model, Model];
  leaning = await client.wait((await client.submit({ preset: "paper", seed: 3, spec: LEANING })).id);
  assert.deepEqual([...models, leaning].map((model) => model.status), ["succeeded", "succeeded", "succeeded"]);
});
after(async () => {
  await closeBrowser();
  await service?.[Symbol.asyncDispose]();
});

async function open(query = "", model = models[0]): Promise<Visit> {
  const visit = await Visit.open(`${service.url}/#/models/${model.id}${query}`);
  await canvasOf(visit.page).waitFor();
  await visit.page.getByText(/triangles are shown/).waitFor();
  return visit;
}

test("cuts, parts, level and flight change the picture", async () => {
  const visit = await open();
  const { page } = visit;
  const whole = await shown(page);
  assert(colours(whole) > 200, `${colours(whole)} colours`);
  await visit.accessible();
  const differs = async (what: string, least: number, from: PNG) => {
    const now = await shown(page);
    assert(difference(from, now) > least, `${what}: ${difference(from, now)}`);
    return now;
  };
  await page.getByRole("checkbox", { name: "Lengthwise" }).check();
  const opened = await differs("opened", 0.02, whole);
  await page.getByRole("slider", { name: "Angle" }).fill("90");
  await differs("opened elsewhere", 0.02, opened);
  await page.getByRole("checkbox", { name: "Lengthwise" }).uncheck();
  assert(difference(whole, await shown(page)) < 0.002, "as before");

  await page.getByRole("checkbox", { name: "Across" }).check();
  const cut = await differs("cut across", 0.02, whole);
  await page.getByRole("slider", { name: "Position" }).fill("0.4");
  await differs("cut elsewhere", 0.02, cut);
  await page.getByRole("checkbox", { name: "Across" }).uncheck();

  await page.getByRole("button", { name: "Ampulla" }).click();
  const ampulla = await differs("the ampulla end", 0.05, whole);
  await page.getByRole("checkbox", { name: "Caps at the ends" }).uncheck();
  await differs("no caps", 0.02, ampulla);
  await page.getByRole("checkbox", { name: "Caps at the ends" }).check();

  const level = page.getByRole("group", { name: "Level of detail" });
  await level.getByRole("button", { name: /^Light/ }).click();
  await level.getByRole("button", { name: /^Light/, pressed: true }).waitFor();
  await canvasOf(page).focus();
  for (let i = 0; i < 8; i++) await page.keyboard.press("+");
  const light = await shown(page);
  await level.getByRole("button", { name: /^Full/ }).click();
  await page.getByText(`${models[0].summary!.triangles.toLocaleString("en")} triangles are shown.`).waitFor();
  await page.getByText(/Largest measured distance from the certified surface: \d+ nm\. Positions are rounded to 0\.\d+, 0\.\d+, 0\.\d+ µm/).waitFor();
  await differs("full detail", 0.0005, light);
  await level.getByRole("button", { name: /^Light/ }).click();

  await page.getByRole("button", { name: "Fly from the isthmus" }).click();
  const inside = await differs("inside", 0.3, light);
  assert(colours(inside) > 50);
  await page.getByRole("slider", { name: "Along the tube" }).fill("0.6");
  const further = await differs("further on", 0.1, inside);
  await canvasOf(page).focus();
  for (let i = 0; i < 10; i++) await page.keyboard.press("ArrowUp");
  await differs("moved by keys", 0.01, further);
  await visit.accessible();
  await page.keyboard.press("Escape");
  await page.getByRole("button", { name: "Fly from the isthmus" }).waitFor();
  await visit.close();
});

/** Distance of a point from a closed polygon. */
function distanceTo({ x, y }: Outline, px: number, py: number): number {
  let least = Infinity;
  for (let i = 0, j = x.length - 1; i < x.length; j = i++) {
    const [dx, dy] = [x[i]! - x[j]!, y[i]! - y[j]!];
    const along = Math.max(0, Math.min(1, ((px - x[j]!) * dx + (py - y[j]!) * dy) / (dx * dx + dy * dy || 1)));
    least = Math.min(least, Math.hypot(x[j]! + along * dx - px, y[j]! + along * dy - py));
  }
  return least;
}

/**
 * A view along the tube, cut at a section of the ampulla that fills the picture's height.
 *
 * Lengths are in micrometres.
 */
async function cutAcross() {
  const sections = await client.sections(models[0].id);
  const { entries } = sections;
  const k = entries.findIndex(({ z_um }) => z_um > 0.85 * entries.at(-1)!.z_um);
  const at = entries[k]!.z_um / entries.at(-1)!.z_um;
  const section = sections.section(k);
  const { x0, y0, x1, y1 } = boundsOf(section.outer);
  const [x, y] = [(x0 + x1) / 2, (y0 + y1) / 2];
  const slope = Math.tan(((FIELD / 2) * Math.PI) / 180);
  const distance = (0.55 * Math.max(x1 - x0, y1 - y0)) / slope;
  const query = `?cam=0_0_${distance / 1000}_${x / 1000}_${y / 1000}_${at}&cut=${at}`;
  return { section, query, x, y, distance, slope };
}

test("cut faces are closed: tissue where the section has tissue, and nowhere else", async () => {
  const { section, query, x, y, distance, slope } = await cutAcross();
  const visit = await open(query);
  await visit.page.getByRole("button", { name: /^Full/ }).click();
  await visit.page.getByText(`${models[0].summary!.triangles.toLocaleString("en")} triangles are shown.`).waitFor();
  const { width, height, data } = await shown(visit.page);
  const pixel = (2 * distance * slope) / height;
  // The edges of the face are lines 12 µm wide.
  const margin = 6 + 2 * pixel;
  const samples = { tissue: 0, lumen: 0, outside: 0 };
  const wrong: string[] = [];
  for (let row = 1; row < height; row += 2) {
    for (let column = 1; column < width; column += 2) {
      const [px, py] = [x + (column + 0.5 - width / 2) * pixel, y - (row + 0.5 - height / 2) * pixel];
      if (Math.min(distanceTo(section.inner, px, py), distanceTo(section.outer, px, py)) < margin) continue;
      const i = 4 * (row * width + column);
      const painted = TISSUE.every((value, channel) => Math.abs(data[i + channel]! - value) <= 2);
      const place = contains(section.inner, px, py) ? "lumen" : contains(section.outer, px, py) ? "tissue" : "outside";
      samples[place]++;
      if (painted !== (place === "tissue")) wrong.push(`${place} at (${column}, ${row})`);
    }
  }
  assert(samples.tissue > 5000 && samples.lumen > 100 && samples.outside > 5000, JSON.stringify(samples));
  assert.deepEqual(wrong.slice(0, 10), []);
  await visit.close();
});

test("the face of a lengthwise cut is tissue where the sections have tissue, and nowhere else", async () => {
  const sections = await client.sections(models[0].id);
  const [low, high] = models[0].summary!.certificate!.bounds_um;
  const [x, y, end] = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]];
  // Seen from the removed side, with the isthmus at the left, in the middle of the ampulla.
  const slope = Math.tan(((FIELD / 2) * Math.PI) / 180);
  const distance = (0.55 * (high[1] - low[1])) / slope;
  const visit = await open(`?cam=-90_0_${distance / 1000}_${x / 1000}_${y / 1000}_0.85&open=0`);
  await visit.page.getByRole("button", { name: /^Full/ }).click();
  await visit.page.getByText(`${models[0].summary!.triangles.toLocaleString("en")} triangles are shown.`).waitFor();
  const { width, height, data } = await shown(visit.page);
  const pixel = (2 * distance * slope) / height;
  const margin = 6 + 3 * pixel;
  const samples = { tissue: 0, lumen: 0, outside: 0 };
  const wrong: string[] = [];
  for (const [k, { z_um }] of sections.entries.entries()) {
    const column = Math.floor((z_um - 0.85 * end) / pixel + width / 2);
    if (column < 0 || column >= width) continue;
    const { inner, outer } = sections.section(k);
    for (let row = 0; row < height; row++) {
      const py = y - (row + 0.5 - height / 2) * pixel;
      if (Math.min(distanceTo(inner, x, py), distanceTo(outer, x, py)) < margin) continue;
      const i = 4 * (row * width + column);
      const painted = SHADED_TISSUE.every((value, channel) => Math.abs(data[i + channel]! - value) <= 2);
      const place = contains(inner, x, py) ? "lumen" : contains(outer, x, py) ? "tissue" : "outside";
      samples[place]++;
      if (painted !== (place === "tissue")) wrong.push(`${place} at (${column}, ${row})`);
    }
  }
  assert(samples.tissue > 500 && samples.lumen > 20 && samples.outside > 100, JSON.stringify(samples));
  assert.deepEqual(wrong.slice(0, 10), [], `${wrong.length} of ${JSON.stringify(samples)}`);
  await visit.close();
});

test("distances in a cut are those of its data", async () => {
  const visit = await open();
  const { page } = visit;
  const slider = page.getByRole("slider", { name: "Section", exact: true });
  await slider.fill("120");
  const cut = await client.cut(models[0].id, { z_um: (await client.section(models[0].id, 120)).z_um });
  const [outer, inner] = (["tissue", "lumen"] as const).map((kind) => cut.rings.find((ring) => ring.kind === kind)!.points) as [number[][], number[][]];
  await page.getByText("121 of 201").waitFor();
  await page.getByText("Planar cut of the surface: no islands, no pockets.").waitFor();
  await page.getByRole("button", { name: "Measure in the section" }).click();
  const result = page.locator("[data-um]");

  // By keyboard, the points are exact.
  const last = inner.length - 1;
  await page.getByRole("spinbutton", { name: "Point A" }).fill("10");
  await page.getByRole("spinbutton", { name: "Point B" }).fill(String(last >> 1));
  const [a, b] = [inner[10]!, inner[last >> 1]!] as [number[], number[]];
  const exact = Math.hypot(a[0]! - b[0]!, a[1]! - b[1]!);
  assert(Math.abs(Number(await result.getAttribute("data-um")) - exact) < 0.01);

  // By pointer, the points are within a pixel.
  const drawing = page.getByRole("img", { name: /^Cross section at/ });
  await drawing.scrollIntoViewIfNeeded();
  const box = (await drawing.boundingBox())!;
  const [left, top, span] = (await drawing.getAttribute("viewBox"))!.split(" ").map(Number) as [number, number, number];
  const ends = [0, outer.length >> 1].map((i) => outer[i]!);
  for (const [x, y] of ends as [number, number][]) {
    await page.mouse.click(box.x + ((x - left) / span) * box.width, box.y + ((-y - top) / span) * box.height);
  }
  const wanted = Math.hypot(ends[0]![0]! - ends[1]![0]!, ends[0]![1]! - ends[1]![1]!);
  const measured = Number(await result.getAttribute("data-um"));
  assert(Math.abs(measured - wanted) <= span / box.width, `${measured} µm instead of ${wanted}`);
  await visit.close();
});

test("distances in 3D are those of points entered, or picked within a pixel", async () => {
  const { section, query, x, y, distance, slope } = await cutAcross();
  const visit = await open(query);
  const { page } = visit;
  await settled(page);
  await page.getByText("Enter coordinates").click();
  for (const [name, value] of [["A x", 0], ["A y", 0], ["A z", 10], ["B x", 0.3], ["B y", 0.4], ["B z", 10]] as const) {
    await page.getByRole("spinbutton", { name: `${name}, mm` }).fill(String(value));
    await page.keyboard.press("Tab");
  }
  const status = page.getByRole("region", { name: "Measure a distance" }).getByRole("status");
  assert.equal(await status.textContent(), "Distance 500 µm");
  await page.getByRole("button", { name: "Clear" }).click();

  // Two distant points of the cut face; the picture shows their positions in the section.
  await page.getByRole("button", { name: "Pick two points" }).click();
  const canvas = canvasOf(page);
  await canvas.scrollIntoViewIfNeeded();
  const box = (await canvas.boundingBox())!;
  const pixel = (2 * distance * slope) / box.height;
  const at = (column: number, row: number) => [x + (column - box.width / 2) * pixel, y - (row - box.height / 2) * pixel] as const;
  const tissue: (readonly [number, number])[] = [];
  for (let column = 0; column < box.width; column += 8) {
    for (let row = 8; row < box.height; row += 8) {
      const [px, py] = at(column, row);
      const margin = Math.min(distanceTo(section.inner, px, py), distanceTo(section.outer, px, py));
      if (margin > 20 && contains(section.outer, px, py) && !contains(section.inner, px, py)) tissue.push([column, row]);
    }
  }
  const ends = [tissue[0]!, tissue.at(-1)!];
  for (const [column, row] of ends) await canvas.click({ position: { x: column, y: row } });
  const picked = await Promise.all(
    ["A", "B"].map((name) => Promise.all(["x", "y", "z"].map(async (axis) => 1000 * Number(await page.getByRole("spinbutton", { name: `${name} ${axis}, mm` }).inputValue())))),
  );
  const wanted = ends.map(([column, row]) => [...at(column, row), section.z_um]);
  const apart = (a: number[], b: number[]) => Math.hypot(...a.map((value, axis) => value - b[axis]!));
  const text = JSON.stringify({ picked, wanted, pixel });
  for (const k of [0, 1]) assert(apart(picked[k]!, wanted[k]!) < pixel, text);
  assert(Math.abs(apart(picked[0]!, picked[1]!) - apart(wanted[0]!, wanted[1]!)) < pixel, text);
  assert(apart(wanted[0]!, wanted[1]!) > 1000, text);
  // The page shows three significant digits.
  const said = await status.textContent();
  assert.equal(said, `Distance ${Number((apart(picked[0]!, picked[1]!) / 1000).toPrecision(3))} mm`);
  await visit.close();
});

test("charts along the tube are the measures of the report, with the published ranges behind them", async () => {
  const report = await client.report(models[0].id);
  const [{ along, regions, tube }, { compared, inside, outside }] = [report.morphometry!, report.comparison!];
  const visit = await open();
  const { page } = visit;
  const panel = page.getByRole("region", { name: "Along the tube" });
  const chart = panel.getByRole("img", { name: /^Tissue area along the tube: / });
  await chart.waitFor();
  assert.equal(await panel.getByRole("img").count(), 12);
  const three = (value: number) => String(Number(value.toPrecision(3)));
  const own = compared.filter(({ quantity, low, high }) => quantity === "tissue_area_mm2" && low != null && high != null);
  const ranges = own.map(({ low, high }) => `${three(low!)} to ${three(high!)}`).join(" or ");
  const values = along["tissue_area_mm2"]!;
  assert.equal(
    await chart.getAttribute("aria-label"),
    `Tissue area along the tube: ${three(values[0]!)} mm² at the isthmus, ${three(values.at(-1)!)} mm² at the ampulla; published ${ranges} mm² over the whole tube`,
  );
  // The line and the bands have the same scale.
  const [, first] = /^M0\.0 ([\d.]+)/.exec((await chart.locator(".chart-line").getAttribute("d"))!)!;
  const bands = await chart.locator(".chart-band").evaluateAll((all) => all.map((band) => ["x", "y", "width", "height"].map((name) => Number(band.getAttribute(name)))));
  assert.equal(bands.length, own.length);
  for (const [k, { low, high, region }] of own.entries()) {
    const [x, y, width, height] = bands[k]! as [number, number, number, number];
    const perUnit = height / (high! - low!);
    assert(Math.abs(y + height - Number(first) - (values[0]! - low!) * perUnit) < 0.1, JSON.stringify({ first, bands }));
    const { from_mm, to_mm } = regions[region]!;
    const scale = 600 / tube.length_mm;
    assert(Math.abs(x - from_mm * scale) < 0.1 && Math.abs(width - (to_mm - from_mm) * scale) < 0.1 && y >= 0, JSON.stringify(bands));
  }

  // Pointing at a chart shows the values in all charts; a click selects the section.
  const box = (await chart.boundingBox())!;
  const at = { x: 0.25 * box.width, y: box.height / 2 };
  await chart.hover({ position: at });
  const z = along["z_mm"] as number[];
  const nearest = nearestIndex(z, 0.25 * tube.length_mm);
  const read = (title: string) => panel.locator("figure", { hasText: title }).locator("output").textContent();
  for (const [title, name, unit] of [["Tissue area", "tissue_area_mm2", " mm²"], ["Outer diameter", "outer_diameter_mm", " mm"]] as const) {
    assert.equal(await read(title), `${three(along[name]![nearest]!)}${unit} at ${three(z[nearest]!)} mm`);
  }
  await chart.click({ position: at });
  // The charts show cuts, the picture the section next to the cut.
  const section = nearestIndex((report.simulated ?? report.morphometry!).along["z_mm"] as number[], z[nearest]!);
  await page.getByText(`${section + 1} of 201`).waitFor();

  // The comparison, whose sources can be opened by keyboard.
  const table = page.getByRole("region", { name: "Beside published anatomy" });
  await table.getByText(`${inside} of ${inside + outside} measures with a published range (oviduct, pig)`).waitFor();
  const row = table.getByRole("row", { name: /^Tissue area whole tube, mm²/ }).first();
  const { measured, source, confidence } = own[0]!;
  assert.equal(await row.getByRole("cell").nth(0).textContent(), three(measured!));
  assert.equal(await table.getByRole("cell", { name: /^(inside|outside)/ }).count(), inside + outside);
  const text = table.getByText(source, { exact: true }).and(page.locator(":visible"));
  assert.equal(await text.count(), 0);
  await row.getByRole("button").press("Enter");
  await text.waitFor();
  await table.getByText(`How it was learnt: ${confidence}.`).and(page.locator(":visible")).waitFor();
  await visit.accessible();

  const opened = page.waitForEvent("popup");
  await page.getByRole("link", { name: "Report as a page" }).click();
  await (await opened).getByRole("heading", { name: /^Pig oviduct, seed 7/ }).waitFor();
  await visit.close();
});

test("of a model that was not measured it is said that there are no charts, and its sections are found", async () => {
  const visit = await Visit.open(service.url);
  const { page } = visit;
  // A report like that of an earlier version.
  const { morphometry, simulated, comparison, ...report } = await client.report(models[0].id);
  assert(morphometry && simulated !== undefined && comparison);
  await page.route(`**/models/${models[0].id}/report`, (route) => route.fulfill({ json: report }));
  await page.goto(`${service.url}/#/models/${models[0].id}`);
  const panel = page.getByRole("region", { name: "Along the tube" });
  await panel.getByText("The version that grew this model did not measure it along the tube.").waitFor();
  assert.equal(await panel.getByRole("img").count(), 0);
  await page.getByText(/^\d+ of 201$/).waitFor();
  await page.getByText("by exact tests of the surface").waitFor();
  assert.equal(await page.getByRole("region", { name: "Beside published anatomy" }).count(), 0);
  await visit.close();
});

test("the ends are named, and a scale bar holds where the picture turns", async () => {
  const visit = await open();
  const { page } = visit;
  const [isthmus, ampulla] = ["isthmus", "ampulla"].map((name) => page.locator(".picture-names text", { hasText: name }));
  const bar = page.locator(".picture-scale b");
  await settled(page);
  const frame = (await canvasOf(page).boundingBox())!;
  for (const name of [isthmus!, ampulla!]) {
    const box = (await name.boundingBox())!;
    assert(box.x >= frame.x && box.x + box.width <= frame.x + frame.width && box.y + box.height <= frame.y + frame.height, JSON.stringify(box));
  }
  // The hidden end and a cut-off end have no names.
  await page.getByRole("button", { name: "Ampulla" }).click();
  await settled(page);
  assert.deepEqual([await isthmus!.isVisible(), await ampulla!.isVisible()], [false, true]);
  await page.getByRole("checkbox", { name: "Across" }).check();
  await settled(page);
  assert.deepEqual([await isthmus!.isVisible(), await ampulla!.isVisible()], [false, false]);
  await page.goto(`${service.url}/#/models/${models[0].id}?cam=-90_0_2_0_0_0.5`);
  await settled(page);
  const text = (await bar.textContent())!;
  const millimetres = Number(/[\d.]+/.exec(text)![0]) * (text.includes("mm") ? 1 : 0.001);
  const height = 2 * 2 * Math.tan(((FIELD / 2) * Math.PI) / 180);
  const { width } = (await bar.boundingBox())!;
  assert(Math.abs(width - (millimetres / height) * frame.height) < 0.5, `${width} pixels for ${text}`);
  await page.getByRole("button", { name: "Fly from the isthmus" }).click();
  await bar.waitFor({ state: "hidden" });
  await isthmus!.waitFor({ state: "hidden" });
  await visit.close();
});

test("little is loaded before the first picture, which comes soon", async () => {
  const begin = Date.now();
  const visit = await Visit.open(`${service.url}/#/models/${models[0].id}`);
  const { page } = visit;
  await page.waitForFunction(() => Number(document.querySelector<HTMLElement>("canvas[data-frames]")?.dataset["frames"]) > 0);
  await page.getByText(/triangles are shown/).waitFor();
  const seconds = (Date.now() - begin) / 1000;
  const sizes = await page.evaluate(() => {
    const files = [...performance.getEntriesByType("navigation"), ...performance.getEntriesByType("resource")] as PerformanceResourceTiming[];
    return files.filter(({ name }) => !name.includes("/models/")).map(({ encodedBodySize }) => encodedBodySize);
  });
  const bytes = sizes.reduce((sum, size) => sum + size, 0);
  console.log(`${bytes} bytes before the first model; its first picture after ${seconds.toFixed(1)} s`);
  assert(bytes > 50_000 && bytes < 400_000, `${bytes} bytes`);
  await visit.close();
});

test("a cross section comes after one cut, without the file of all sections", async () => {
  const visit = await Visit.open(service.url);
  const { page } = visit;
  const asked: string[] = [];
  page.on("request", (request) => {
    const name = /\/models\/[^/]+\/(cut|sections|report|files\/sections\.bin)/.exec(request.url())?.[1];
    if (name) asked.push(name);
  });
  await page.goto(`${service.url}/#/models/${models[0].id}`);
  await page.getByText(/^Planar cut of the surface: /).waitFor();
  await page.getByText(/^\d+ of 201$/).waitFor();
  await page.getByText(/triangles are shown/).waitFor();
  assert.deepEqual(asked.sort(), ["cut", "report"]);
  await visit.close();
});

test("a link restores the view", async () => {
  const visit = await open();
  const { page } = visit;
  await page.getByRole("checkbox", { name: "Lengthwise" }).check();
  await page.getByRole("checkbox", { name: "Outer wall", exact: true }).uncheck();
  await page.getByRole("checkbox", { name: "Plane of the section" }).check();
  await canvasOf(page).focus();
  for (const key of ["ArrowLeft", "ArrowLeft", "ArrowUp", "+", "+"]) await page.keyboard.press(key);
  // The focus ring is not part of the view.
  await canvasOf(page).blur();
  const before = await shown(page);
  await page.waitForFunction(() => location.hash.includes("cam="));
  await page.waitForTimeout(600);
  const link = page.url();
  await visit.close();
  const again = await open(link.slice(link.indexOf("?")));
  const after = await shown(again.page);
  assert(difference(before, after) < 0.01, `${difference(before, after)}`);
  await again.close();
});

test("a download has the bytes of its hash", async () => {
  const visit = await open();
  const { page } = visit;
  const file = models[0].files.find(({ name }) => name === "model.lod2.glb")!;
  const downloaded = page.waitForEvent("download");
  await page.getByRole("button", { name: "Download model.lod2.glb" }).click();
  const path = await (await downloaded).path();
  assert.equal(createHash("sha256").update(readFileSync(path)).digest("hex"), file.sha256);
  await visit.close();
});

test("a cut is saved as SVG, as PNG and as JSON", async () => {
  const visit = await open();
  const { page } = visit;
  const save = async (kind: string) => {
    const downloaded = page.waitForEvent("download");
    await page.getByRole("button", { name: kind, exact: true }).click();
    const download = await downloaded;
    return { name: download.suggestedFilename(), data: readFileSync(await download.path()) };
  };
  const svg = await save("SVG");
  assert.match(svg.name, /^cut-\d+um\.svg$/);
  assert.match(svg.data.toString(), /<svg /);
  const png = await save("PNG");
  assert.match(png.name, /^cut-\d+um\.png$/);
  const drawing = PNG.sync.read(png.data);
  assert.equal(Math.max(drawing.width, drawing.height), 2048);
  assert(colours(drawing) > 20, `${colours(drawing)} colours`);
  const json = await save("JSON");
  assert.match(json.name, /^cut-\d+um\.json$/);
  assert.equal((JSON.parse(json.data.toString()) as Cut).rings[0]!.kind, "tissue");
  await page.getByRole("button", { name: "Stained" }).click();
  const stained = await save("PNG");
  assert.match(stained.name, /^cut-\d+um-stained\.png$/);
  const slide = PNG.sync.read(stained.data);
  assert.equal(Math.max(slide.width, slide.height), 2048);
  assert(colours(slide) > 1000, `${colours(slide)} colours`);
  await visit.close();
});

/** A position in the ampulla of the leaning model whose cut has islands and pockets. */
async function islanded(): Promise<{ cut: Cut; at: number }> {
  const [low, high] = leaning.summary!.certificate!.bounds_um;
  for (const { z_um } of (await client.sections(leaning.id)).entries.slice(20, -1)) {
    const cut = await client.cut(leaning.id, { z_um });
    if (cut.islands > 1 && cut.pockets > 0) return { cut, at: (z_um - low[2]) / (high[2] - low[2]) };
  }
  throw new Error("no cut of the leaning model has islands and pockets");
}

test("the cut of a leaning model has its islands, in the drawing, in pictures and in 3D", async () => {
  const { cut, at } = await islanded();
  const lines = cut.rings.map(({ points }) => ({ x: points.map(([u]) => u!), y: points.map(([, v]) => v!) }));
  const { x0, y0, x1, y1 } = boundsOf(lines[0]!);
  const [x, y] = [(x0 + x1) / 2, (y0 + y1) / 2];
  const slope = Math.tan(((FIELD / 2) * Math.PI) / 180);
  const distance = (0.55 * Math.max(x1 - x0, y1 - y0)) / slope;
  const visit = await open(`?cam=0_0_${distance / 1000}_${x / 1000}_${y / 1000}_${at}&cut=${at}&at=${at}`, leaning);
  const { page } = visit;
  const panel = page.getByRole("region", { name: "Cross section" });
  const caption = panel.getByText(/^Planar cut of the surface: /);
  await caption.waitFor();
  const said = /: (\d+) islands \(.*\), (\d+) pockets? \(.*\)\.$/.exec((await caption.textContent())!);
  assert.deepEqual(said?.slice(1).map(Number), [cut.islands, cut.pockets]);
  const drawing = page.getByRole("img", { name: /^Cross section at/ });
  assert.deepEqual([await drawing.locator(".island").count(), await drawing.locator(".pocket").count()], [cut.islands, cut.pockets]);
  await visit.accessible();

  // In 3D, the cut face shows tissue exactly where the cut has tissue.
  const level = page.getByRole("group", { name: "Level of detail" });
  await level.getByRole("button", { name: /^Full/ }).click();
  await level.getByRole("button", { name: /^Full/, pressed: true }).waitFor();
  const { width, height, data } = await shown(page);
  const pixel = (2 * distance * slope) / height;
  const samples = { tissue: 0, empty: 0, wrong: 0 };
  for (let row = 2; row < height; row += 5) {
    for (let column = 2; column < width; column += 5) {
      const [px, py] = [x + (column + 0.5 - width / 2) * pixel, y - (row + 0.5 - height / 2) * pixel];
      if (Math.min(...lines.map((line) => distanceTo(line, px, py))) < 6 + 2 * pixel) continue;
      const i = 4 * (row * width + column);
      const painted = TISSUE.every((value, channel) => Math.abs(data[i + channel]! - value) <= 2);
      const isTissue = lines.filter((line) => contains(line, px, py)).length % 2 === 1;
      samples[isTissue ? "tissue" : "empty"]++;
      if (painted !== isTissue) samples.wrong++;
    }
  }
  assert(samples.tissue > 1000 && samples.empty > 1000 && samples.wrong === 0, JSON.stringify(samples));

  const drawn = await picture(drawing);
  for (const name of ["Stained", "Tissues"]) {
    await page.getByRole("button", { name }).click();
    await page.getByRole("button", { name, pressed: true }).waitFor();
    await drawing.locator("image").waitFor();
    await page.waitForTimeout(500);
    assert(difference(drawn, await picture(drawing)) > 0.1, name);
    await visit.accessible();
  }
  assert.match(page.url(), /look=labels/);
  await visit.close();
});

test("places that are passed by are not cut, and without a cut there is the section", async () => {
  const visit = await open("", leaning);
  const { page } = visit;
  const caption = page.getByText(/^(Planar cut of the surface|Section of the simulation)/);
  await page.getByText(/^Planar cut of the surface: /).waitFor();
  let asked = 0;
  let status = 200;
  await page.route("**/cut?*", async (route) => {
    asked++;
    if (status === 200) return route.continue();
    const slug = status === 404 ? "file-not-found" : "internal";
    const problem = { type: `urn:oviduct:problem:${slug}`, title: slug, status, detail: "It is out of order." };
    return route.fulfill({ status, contentType: "application/problem+json", body: JSON.stringify(problem) });
  });
  const slider = page.getByRole("slider", { name: "Section", exact: true });
  for (let k = 1; k <= 35; k++) await slider.fill(String(k));
  await page.getByText("36 of 41").waitFor();
  await page.getByText(/^Planar cut of the surface: /).waitFor();
  assert(asked >= 1 && asked <= 10, `${asked} cuts for 35 places`);

  visit.refusals = [500, 404];
  status = 500;
  await slider.fill("2");
  await page.getByText("Section of the simulation: It is out of order.").waitFor();
  status = 200;
  await caption.getByRole("button", { name: "Try again" }).click();
  await page.getByText("Planar cut of the surface: no islands, no pockets.").waitFor();
  status = 404;
  await slider.fill("3");
  await page.getByText("Section of the simulation: the model has no surface that can be cut.").waitFor();
  asked = 0;
  await slider.fill("5");
  await page.getByText("6 of 41").waitFor();
  await page.waitForTimeout(500);
  assert.equal(asked, 0, "no plane can cut it");
  await page.getByRole("button", { name: "Stained" }).click();
  await page.getByRole("img", { name: /^Cross section at/ }).locator("image").waitFor();
  await visit.accessible();
  await visit.close();
});

test("two models are compared with one camera", async () => {
  const visit = await Visit.open(`${service.url}/#/compare/${models[0].id}/${models[1].id}`);
  const { page } = visit;
  await canvasOf(page).nth(1).waitFor();
  await settled(page);
  const pictures = async () => [await picture(canvasOf(page).nth(0)), await picture(canvasOf(page).nth(1))] as const;
  for (const name of ["first model, pig, seed 7", "second model, pig, seed 8"]) assert.equal(await page.getByRole("application", { name }).count(), 1);
  const before = await pictures();
  await page.getByRole("button", { name: "Ampulla" }).click();
  await settled(page);
  await page.waitForTimeout(500);
  const after = await pictures();
  for (const k of [0, 1] as const) assert(difference(before[k], after[k]) > 0.05, `picture ${k}`);
  assert(difference(after[0], after[1]) > 0.01, "the models differ");
  await visit.accessible();
  await visit.close();
});

test("positions in two tubes of different length are those of each", async () => {
  const { spec } = SMALL;
  const short = await client.submit({ preset: "pig", seed: 3, spec: { ...spec, length_mm: 40 } }, { wait: 60 });
  const visit = await Visit.open(`${service.url}/#/`);
  const { page } = visit;
  let answer = () => {};
  const held = new Promise<void>((resolve) => (answer = resolve));
  await page.route(`**/models/${models[0].id}/way`, async (route) => {
    await held;
    await route.continue();
  });
  await page.goto(`${service.url}/#/compare/${short.id}/${models[0].id}?cut=0.5`);
  await page.getByRole("img", { name: /^Cross section at/ }).first().waitFor();
  const cut = page.getByRole("slider", { name: "Position" });
  assert.equal(await cut.getAttribute("aria-valuetext"), "20 and 30 mm");
  await page.getByRole("button", { name: "Fly from the isthmus" }).click();
  await page.locator(".compare-model").getByText("Looking for the way through the lumen …").first().waitFor();
  answer();
  const along = page.getByRole("slider", { name: "Along the tube" });
  for (let i = 0; i < 30; i++) {
    await canvasOf(page).first().press("PageUp");
  }
  assert.equal(await along.getAttribute("aria-valuetext"), "20 and 30 mm");
  await page.getByText("The speed is that in the longer tube.").waitFor();

  // Styles of the previous page stay loaded and must not affect the next page.
  await page.getByRole("heading", { name: "pig, seed 7" }).getByRole("link").click();
  const frame = page.getByRole("region", { name: "Model in 3D" });
  await frame.waitFor();
  const [outer, inner] = [(await frame.boundingBox())!, (await canvasOf(page).boundingBox())!];
  assert(inner.y >= outer.y && inner.y + inner.height <= outer.y + outer.height, "the picture leaves its frame");
  await visit.close();
});

test("models that still grow are compared once they have finished", async () => {
  await client.pauseWorkers();
  const { id } = await client.submit({ ...SMALL, seed: 9 });
  const visit = await Visit.open(`${service.url}/#/compare/${models[0].id}/${id}`);
  await visit.page.getByRole("heading", { name: "Only finished models can be compared" }).waitFor();
  await client.resumeWorkers();
  await canvasOf(visit.page).nth(1).waitFor({ timeout: 240_000 });
  await visit.close();
});

test("of a model without figures it is said that there are none", async () => {
  const visit = await Visit.open(service.url);
  const { page } = visit;
  // A model like those from before the service kept summaries.
  await page.route(`**/models/${models[0].id}`, (route) => route.fulfill({ json: { ...models[0], summary: undefined } }));
  await page.goto(`${service.url}/#/compare/${models[0].id}/${models[1].id}`);
  await page.getByRole("heading", { name: "There is nothing to compare" }).waitFor();
  await page.getByText("The service keeps no figures of pig, seed 7.").waitFor();
  await visit.close();
});

test("what does not come leaves the rest, and comes later", async () => {
  const visit = await Visit.open(service.url);
  const { page } = visit;
  visit.away = true;
  let missing = /\/(model\.lod1\.glb|report)(\?|$)/;
  await page.route("**/models/**", (route) => (missing.test(route.request().url()) ? route.abort() : route.continue()));
  await page.goto(`${service.url}/#/models/${models[0].id}`);
  await page.getByRole("heading", { name: "The report could not be loaded" }).waitFor();
  // The cut needs no report; only the places of the sections do.
  await page.getByRole("img", { name: /^Cross section at/ }).waitFor();
  assert(await page.getByRole("slider", { name: "Section", exact: true }).isDisabled());
  const level = page.getByRole("group", { name: "Level of detail" });
  await level.getByRole("button", { name: /^Medium/ }).click();
  const fault = page.getByRole("alert").filter({ hasText: /^Medium detail could not be loaded/ });
  await fault.waitFor();
  assert(colours(await picture(canvasOf(page))) > 200, "the lightest level is still shown");
  await visit.accessible();

  missing = /\/(model\.lod0\.glb|report)(\?|$)/;
  await fault.getByRole("button", { name: "Try again" }).click();
  await level.getByRole("button", { name: /^Medium/, pressed: true }).waitFor();
  await fault.waitFor({ state: "detached" });

  await level.getByRole("button", { name: /^Full/ }).click();
  await page.getByText(/^Full detail could not be loaded/).waitFor();
  missing = /^$/;
  // Simulates a return of the network, so the event stream is reopened.
  await page.evaluate(() => dispatchEvent(new Event("online")));
  await page.getByText(`${models[0].summary!.triangles.toLocaleString("en")} triangles are shown.`).waitFor();
  await page.getByText("by exact tests of the surface").waitFor();
  await page.getByText(/^\d+ of 201$/).waitFor();
  assert.equal(await page.getByRole("alert").count(), 0);
  await visit.close();
});

test("two fingers zoom a section about their middle", async () => {
  const visit = await Visit.open(`${service.url}/#/models/${models[0].id}`, { hasTouch: true });
  const { page } = visit;
  const drawing = page.getByRole("img", { name: /^Cross section at/ });
  await drawing.scrollIntoViewIfNeeded();
  const box = (await drawing.boundingBox())!;
  const [x, y] = [box.x + 0.4 * box.width, box.y + 0.55 * box.height];
  /** Span of the drawing, and its point between the fingers; micrometres. */
  const seen = async () => {
    const [left, top, span] = (await drawing.getAttribute("viewBox"))!.split(" ").map(Number) as [number, number, number];
    return { span, x: left + ((x - box.x) / box.width) * span, y: top + ((y - box.y) / box.height) * span };
  };
  const before = await seen();
  const debug = await page.context().newCDPSession(page);
  const touch = (type: "touchStart" | "touchMove" | "touchEnd", ...apart: number[]) =>
    debug.send("Input.dispatchTouchEvent", {
      type, touchPoints: apart.flatMap((half) => [{ x: x - half, y, id: 1 }, { x: x + half, y, id: 2 }]),
    });
  await touch("touchStart", 30);
  for (let half = 36; half <= 90; half += 6) await touch("touchMove", half);
  await touch("touchEnd");
  const after = await seen();
  assert(Math.abs(before.span / after.span - 3) < 0.05, `zoomed ${before.span / after.span} times`);
  const moved = (Math.hypot(after.x - before.x, after.y - before.y) / after.span) * box.width;
  assert(moved < 2, `by ${moved} pixels`);
  await visit.close();
});

test("one finger turns the model, two zoom it", async () => {
  const visit = await Visit.open(`${service.url}/#/models/${models[0].id}`, { hasTouch: true });
  const { page } = visit;
  await settled(page);
  const box = (await canvasOf(page).boundingBox())!;
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const debug = await page.context().newCDPSession(page);
  const touch = (type: "touchStart" | "touchMove" | "touchEnd", ...points: [number, number][]) =>
    debug.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([right, down], id) => ({ x: x + right, y: y + down, id })) });
  const camera = async () => {
    // The link is updated after a delay.
    await page.waitForTimeout(800);
    return new URLSearchParams(new URL(page.url()).hash.split("?")[1]).get("cam")!.split("_").map(Number) as number[];
  };
  await touch("touchStart", [0, 0]);
  for (let way = 10; way <= 60; way += 10) await touch("touchMove", [way, way / 3]);
  await touch("touchEnd");
  const [azimuth, elevation, distance] = await camera();
  // From 24° left and 10° above, by 0.35° per pixel.
  assert(Math.abs(azimuth! + 24 + 21) < 0.5 && Math.abs(elevation! - 10 - 7) < 0.5, `${azimuth}, ${elevation}`);
  await touch("touchStart", [-30, 0], [30, 0]);
  for (let half = 36; half <= 90; half += 6) await touch("touchMove", [-half, 0], [half, 0]);
  await touch("touchEnd");
  const after = await camera();
  assert(Math.abs(distance! / after[2]! - 3) < 0.05, `zoomed ${distance! / after[2]!} times`);
  assert.deepEqual(after.slice(0, 2), [azimuth, elevation]);
  assert.equal(await page.evaluate(() => scrollY), 0);
  await visit.close();
});

test("a phone has room for everything", async () => {
  const visit = await Visit.open(`${service.url}/#/models/${models[0].id}`, {
    viewport: { width: 390, height: 844 }, hasTouch: true, colorScheme: "dark",
  });
  const { page } = visit;
  await settled(page);
  assert(colours(await picture(canvasOf(page))) > 200);
  const width = await page.evaluate(() => document.documentElement.scrollWidth);
  assert(width <= 390, `the page is ${width} pixels wide`);
  await page.getByRole("checkbox", { name: "Lengthwise" }).tap();
  await visit.accessible();
  await visit.close();
});

test("without WebGL2 pictures and sections remain", async () => {
  const visit = await Visit.open(service.url);
  await visit.page.addInitScript(() => {
    // Simulates a browser without a graphics processor.
    HTMLCanvasElement.prototype.getContext = () => null;
  });
  await visit.page.goto(`${service.url}/#/models/${models[0].id}`);
  await visit.page.reload();
  await visit.page.getByText(/does not offer WebGL2/).waitFor();
  await visit.page.getByRole("img", { name: /^Cross section at/ }).waitFor();
  await visit.close();
});

test("ten models opened and closed leave nothing behind", async () => {
  const visit = await open();
  const { page } = visit;
  const debug = await page.context().newCDPSession(page);
  const held = async () => {
    let [usedSize, backingStorageSize] = [Infinity, Infinity];
    // Array buffers are freed in the background, which is late on a busy machine.
    for (let round = 0; round < 6; round++) {
      await debug.send("HeapProfiler.collectGarbage");
      await page.waitForTimeout(500);
      const usage = await debug.send("Runtime.getHeapUsage");
      usedSize = Math.min(usedSize, usage.usedSize);
      backingStorageSize = Math.min(backingStorageSize, usage.backingStorageSize);
    }
    const { nodes, jsEventListeners: listeners } = await debug.send("Memory.getDOMCounters");
    return { usedSize, backingStorageSize, nodes, listeners };
  };
  const cycle = async () => {
    await page.getByRole("link", { name: "Models", exact: true }).click();
    await page.getByRole("link", { name: "Pig oviduct" }).first().click();
    await page.getByText(/triangles are shown/).waitFor();
    await settled(page);
  };
  await cycle();
  await cycle();
  const start = await held();
  for (let i = 0; i < 8; i++) await cycle();
  const end = await held();
  const grown = (name: keyof typeof end) => end[name] - start[name];
  const text = JSON.stringify({ start, end });
  console.log(text);
  assert(grown("usedSize") < 8e6 && grown("backingStorageSize") < 8e6, text);
  assert(grown("nodes") < 100 && grown("listeners") < 8, text);
  await visit.close();
});

test("a frame of a flight allocates next to nothing", async () => {
  // A small picture, so that the code of the loop is compiled soon. Until then, V8 keeps
  // intermediate numbers on the heap. It always does so with numbers passed to the browser, such as
  // uniforms of three.js. A mistake would cost a multiple.
  const viewport = { width: 390, height: 500 };
  const visit = await Visit.open(`${service.url}/#/models/${models[0].id}`, { reducedMotion: "no-preference", viewport });
  const { page } = visit;
  await settled(page);
  const debug = await page.context().newCDPSession(page);
  const frames = async () => Number(await canvasOf(page).getAttribute("data-frames"));
  // The drawings of cuts are not part of the loop.
  await page.route("**/cut?*", () => {});
  const draw = async (count: number) => {
    for (const end = (await frames()) + count; (await frames()) < end; ) await page.waitForTimeout(50);
  };
  await page.getByRole("button", { name: "Fly from the isthmus" }).click();
  await draw(400);
  const [start, begin] = [await frames(), Date.now()];
  await debug.send("HeapProfiler.startSampling", {
    samplingInterval: 128, includeObjectsCollectedByMajorGC: true, includeObjectsCollectedByMinorGC: true,
  });
  await draw(100);
  const { profile } = await debug.send("HeapProfiler.stopSampling");
  const drawn = (await frames()) - start;
  const rate = (1000 * drawn) / (Date.now() - begin);
  type Node = (typeof profile)["head"];
  const places = new Map<string, number>();
  const count = (node: Node): void => {
    const { functionName, url, lineNumber, columnNumber } = node.callFrame;
    const place = `${functionName} ${url.split("/").at(-1)}:${lineNumber}:${columnNumber}`;
    if (url.includes("/assets/")) places.set(place, (places.get(place) ?? 0) + node.selfSize);
    node.children.forEach(count);
  };
  count(profile.head);
  const most = [...places].sort((a, b) => b[1] - a[1]);
  const perFrame = (of: typeof most) => of.reduce((sum, [, size]) => sum + size, 0) / drawn;
  const [all, ours] = [perFrame(most), perFrame(most.filter(([place]) => !place.includes("three.module")))];
  console.log(`${rate.toFixed(1)} frames a second, ${all.toFixed(0)} bytes allocated in each, ${ours.toFixed(0)} of them not by three.js`);
  // This includes the panels that follow the flight, four times a second.
  assert(all < 12_000 && ours < 9500, `most by ${JSON.stringify(most.slice(0, 20))}`);
  await visit.close();
});
