// Planar cuts: their drawing, the requested planes, and their description.
import assert from "node:assert/strict";
import { test } from "node:test";
import { OviductError, type Cut, type Report } from "../../clients/typescript/src/index.ts";
import { areas, extentOf, names, ofCut, ofSection } from "../src/explore/cross-section.ts";
import { answered, planeAt } from "../src/explore/cuts.ts";
import { Latest } from "../src/explore/latest.ts";
import { colour, sizeFor, slideOptions, TISSUES } from "../src/explore/slides.ts";
import { squareMicrometres } from "../src/ui/format.ts";
import { census, islands } from "../src/explore/words.ts";

const square = (side: number): [number, number][] => [[0, 0], [side, 0], [side, side], [0, side]];

const cut: Cut = {
  model: "00000000-0000-7000-8000-000000000000",
  file: "model.glb",
  units: "um",
  plane: { origin_um: [0, 0, 5], normal: [0, 0, 1], u: [1, 0, 0], v: [0, 1, 0] },
  tissue_area_um2: 38,
  lumen_area_um2: 62,
  islands: 2,
  pockets: 1,
  rings: [
    { kind: "tissue", parent: null, area_um2: 100, perimeter_um: 40, points: square(10) },
    { kind: "lumen", parent: 0, area_um2: 64, perimeter_um: 32, points: square(8).reverse() },
    { kind: "island", parent: 1, area_um2: 4, perimeter_um: 8, points: square(2) },
    { kind: "island", parent: 1, area_um2: 1, perimeter_um: 4, points: square(1) },
    { kind: "pocket", parent: 2, area_um2: 0.25, perimeter_um: 2, points: square(0.5).reverse() },
  ],
};

test("a cut is drawn by its rings", () => {
  const section = ofCut(cut);
  assert.deepEqual([section.source, section.tissue, section.lumen], ["surface", 38, 62]);
  assert.deepEqual(section.contours.map(({ kind }) => kind), ["tissue", "lumen", "island", "island", "pocket"]);
  assert.deepEqual(Array.from(section.contours[1]!.y), [8, 8, 0, 0]);
  assert.deepEqual(names(section), ["outer wall", "mucosa", "island 1", "island 2", "pocket 1"]);
  assert.deepEqual([areas(section, "island"), areas(section, "pocket")], [[4, 1], [0.25]]);
  assert.deepEqual(extentOf(section), { x0: 0, y0: 0, x1: 10, y1: 10 });
});

test("a section of the simulation is drawn by its contours", () => {
  const ring = (side: number) => ({ ids: [0, 1, 2, 3], points: square(side) });
  const section = ofSection({ inner: ring(8), outer: ring(10) });
  assert.deepEqual([section.source, section.tissue, section.lumen], ["simulation", 36, 64]);
  assert.deepEqual(names(section), ["outer wall", "mucosa"]);
});

test("planes are within the surface", () => {
  assert.deepEqual([-3, 0, 0.7, 500, 999.9, 1000].map((z) => planeAt(z, 0, 1000)), [0.5, 0.5, 0.7, 500, 999.5, 999.5]);
});

function problem(status: number, slug: string): OviductError {
  const type = `urn:oviduct:problem:${slug}` as NonNullable<OviductError["problem"]>["type"];
  return new OviductError(new Response(null, { status }), { type, title: slug, status, detail: slug } as NonNullable<OviductError["problem"]>);
}

test("refusals for good end the requests, others are of a plane, or errors", async () => {
  assert.deepEqual(await answered(Promise.resolve(cut)), { cut });
  const ever = async (status: number, slug: string) => {
    const answer = await answered(Promise.reject(problem(status, slug)));
    return answer.cut === undefined && answer.ever;
  };
  assert.deepEqual([await ever(404, "file-not-found"), await ever(422, "surface-too-large"), await ever(404, "cut-not-found")], [true, true, false]);
  await assert.rejects(answered(Promise.reject(problem(404, "model-not-found"))), OviductError);
  await assert.rejects(answered(Promise.reject(new TypeError("away"))), TypeError);
});

test("what is passed by is not loaded, what was loaded is kept, what is no longer wanted is aborted", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const [asked, dropped, aborted]: [string[], string[], string[]] = [[], [], []];
  const answers = new Map<string, (value: string) => void>();
  const latest = new Latest<string>(100, 2, (value) => dropped.push(value));
  const want = (key: string) => latest.want(key, (signal) => {
    asked.push(key);
    signal.addEventListener("abort", () => aborted.push(key));
    return new Promise((resolve) => answers.set(key, resolve));
  });
  const answer = async (key: string) => {
    answers.get(key)!(key.toUpperCase());
    await new Promise(setImmediate);
  };
  want("first");
  context.mock.timers.tick(0);
  assert.deepEqual(asked.splice(0), ["first"], "the first request waits for nothing");
  want("a");
  context.mock.timers.tick(60);
  want("b");
  context.mock.timers.tick(60);
  assert.deepEqual([asked, latest.awaited.value], [[], "b"]);
  want("b");
  context.mock.timers.tick(40);
  assert.deepEqual(asked, ["b"]);
  let settled = false;
  void latest.settled().then(() => (settled = true));
  await new Promise(setImmediate);
  assert(!settled);
  await answer("b");
  assert(settled);
  assert.deepEqual([latest.outcome.value, latest.awaited.value], [{ key: "b", value: "B" }, undefined]);

  want("c");
  context.mock.timers.tick(100);
  want("b");
  assert.deepEqual([asked, aborted.at(-1), latest.outcome.value], [["b", "c"], "c", { key: "b", value: "B" }]);
  await answer("c");
  assert.deepEqual([latest.outcome.value?.key, dropped], ["b", ["C"]], "an answer after the abort is dropped");

  for (const key of ["d", "e"]) {
    want(key);
    context.mock.timers.tick(100);
    await answer(key);
  }
  assert.deepEqual(dropped, ["C", "B"], "two are kept");
  latest.dispose();
  assert.deepEqual([dropped, latest.outcome.value], [["C", "B", "D", "E"], undefined]);
});

test("what failed is loaded again when that is asked for", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  let tries = 0;
  const latest = new Latest<number>(100, 2);
  latest.again();
  latest.want("a", () => (++tries === 1 ? Promise.reject(new Error("away")) : Promise.resolve(tries)));
  context.mock.timers.tick(100);
  await new Promise(setImmediate);
  assert.match(String(latest.outcome.value?.fault), /away/);
  latest.again();
  context.mock.timers.tick(0);
  await new Promise(setImmediate);
  assert.deepEqual(latest.outcome.value, { key: "a", value: 2 });
  latest.again();
  context.mock.timers.tick(0);
  assert.equal(tries, 2, "nothing has failed");
});

test("labels become the colours of the legend", () => {
  const pixels = Uint8ClampedArray.from([0, 1, 2, 6, 9, 10].flatMap((value) => [value, value, value, 255]));
  colour(pixels);
  const rgba = Array.from({ length: 6 }, (_, i) => Buffer.from(pixels.subarray(4 * i, 4 * i + 4)).toString("hex"));
  assert.deepEqual([rgba[0]!.slice(6), rgba[1]!.slice(6), rgba[5]!.slice(6)], ["00", "00", "00"]);
  assert.deepEqual([rgba[2], rgba[3], rgba[4]], [TISSUES[0].color, TISSUES[4].color, TISSUES[7].color].map((color) => `${color.slice(1)}ff`));
  assert.equal(new Set(TISSUES.map(({ color }) => color)).size, 8);
});

test("pictures are of few sizes, and stained or labels", () => {
  assert.deepEqual([300, 1100, 1101, 9000].map(sizeFor), [1024, 1024, 2048, 2048]);
  assert.deepEqual([slideOptions("stained", 64), slideOptions("labels", 64)], [{ size: 64, stain: "he" }, { size: 64, labels: true }]);
});

test("islands in words", () => {
  assert.deepEqual([0, 0.34, 1727.6, 99_900, 99_999, 440_000].map(squareMicrometres), ["0 µm²", "0.34 µm²", "1,730 µm²", "99,900 µm²", "0.1 mm²", "0.44 mm²"]);
  assert.deepEqual([census([], "island"), census([1730], "island"), census([3324, 1898], "pocket")], ["no islands", "1 island (1,730 µm²)", "2 pockets (5,220 µm²)"]);
  const cuts: NonNullable<Report["cuts"]> = {
    count: 40, from_mm: 24, to_mm: 60, least_island_um2: 500, with_islands: 0.675, islands_per_cut: 2.125, pockets_per_cut: 2.675,
    island_area_um2: { p5: 604.2, p50: 1727.55, p95: 5472.2, cv: 0.76 }, thickness_um: null, gap_um: null,
  };
  assert.equal(islands({ cuts }), "Islands in 68 % of 40 planar cuts through the ampulla, 2.1 a cut, median 1,730 µm²");
  assert.equal(islands({ cuts: { ...cuts, with_islands: 0, islands_per_cut: 0, island_area_um2: null } }), "No islands in 40 planar cuts through the ampulla");
  assert.deepEqual([islands({ cuts: null }), islands({})], [undefined, undefined]);
});
