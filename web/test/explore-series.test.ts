// Plots along the tube, and comparisons with publications.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { deviation, range } from "../src/explore/comparison.tsx";
import { quantity } from "../src/explore/quantities.ts";
import { bandsOf, extent, known, published, seriesOf, type Comparison, type Morphometry } from "../src/explore/series.ts";

const region = (from_mm: number, to_mm: number) => ({ from_mm, to_mm, sections: 3, quantities: {} });

/** Nine sections of a tube of 8 mm; every fourth one has a shape tree. */
const morphometry = {
  along: {
    z_mm: [0, 1, 2, 3, 4, 5, 6, 7, 8],
    folds_on_ring: [5, 6, null, 7, 7, 8, 9, 9, 9],
    branching_order_mean: [1, null, null, null, 1.5, null, null, null, 2],
    outer_diameter_mm: [2, 2, 2, 2, 3, 3, 3, 3, 3],
    fold_height_p50_um: Array<null>(9).fill(null),
    lacunarity: [1, 1, 1, 1, 1, 1, 1, 1, 1],
  },
  regions: { isthmus: region(0, 3), ampulla: region(4, 8), whole: region(0, 8) },
  settings: { tree_every: 4 },
} as unknown as Morphometry;

type Row = Comparison["compared"][number];
const row = (quantity: string, region: string, more: Partial<Row>): Row =>
  ({ quantity, region, verdict: "inside", published: "", source: "", confidence: "", ...more });
const comparison = {
  organ: "oviduct", species: "pig", inside: 0, outside: 0, no_reference: [],
  compared: [
    row("folds_on_ring", "isthmus", { low: 4, high: 8 }),
    row("folds_on_ring", "ampulla", { low: 30, high: 38.5 }),
    row("folds_on_ring", "isthmus", { low: 1, high: 2 }),
    row("folds_on_ring", "ampulla", { value: 40 }),
    row("folds_on_ring", "ampulla", { low: 20 }),
    row("folds_on_ring", "junction", { low: 10, high: 12 }),
    row("folds_on_ring", "tube", { low: 10, high: 12 }),
    row("outer_diameter_mm", "whole", { low: 1, high: 5 }),
  ],
} satisfies Comparison;

test("the quantities that the model has are plotted, in the order of the report", () => {
  const all = seriesOf(morphometry, comparison);
  assert.deepEqual(all.map(({ title, unit }) => [title, unit]), [["Folds on the ring", ""], ["Branching order, mean", ""], ["Outer diameter", "mm"]]);
  assert.deepEqual(all.map(({ bands }) => bands.length), [3, 0, 1]);
  assert.deepEqual(seriesOf(morphometry, undefined).map(({ bands }) => bands.length), [0, 0, 0]);
});

test("a section without a value is a gap, unless its shape tree is not made", () => {
  const [folds, order] = seriesOf(morphometry, undefined);
  assert.deepEqual([folds!.z, folds!.starts], [[0, 1, 3, 4, 5, 6, 7, 8], [0, 2]]);
  assert.deepEqual([order!.z, order!.values, order!.starts], [[0, 4, 8], [1, 1.5, 2], [0]]);
  // A computed shape tree may have no value.
  const gap = known([0, 1, 2, 3, 4, 5, 6], [1, null, null, null, 2, null, 3], 2);
  assert.deepEqual(gap, { z: [0, 4, 6], values: [1, 2, 3], starts: [0, 1] });
  assert.deepEqual(known([0, 1], [null, null], 1), { z: [], values: [], starts: [] });
});

test("bands are the published ranges with two ends, where the model has the region", () => {
  const bands = bandsOf("folds_on_ring", morphometry, comparison);
  assert.deepEqual(bands[1], { region: "ampulla", from: 4, to: 8, low: 30, high: 38.5 });
  assert.deepEqual(bands.map(({ region, low }) => [region, low]), [["isthmus", 4], ["ampulla", 30], ["isthmus", 1]]);
  assert.equal(published({ bands, unit: "" }), "published 4 to 8 or 1 to 2 in the isthmus, 30 to 38.5 in the ampulla");
  assert.equal(published({ bands: bandsOf("outer_diameter_mm", morphometry, comparison), unit: "mm" }), "published 1 to 5 mm over the whole tube");
  assert.equal(published({ bands: [], unit: "mm" }), "");
});

test("the axis includes line and bands, and begins at 0 unless the values vary little", () => {
  const bands = bandsOf("folds_on_ring", morphometry, comparison);
  assert.deepEqual(extent({ values: [5, 9], bands }), { bottom: 0, top: 38.5 * 1.06 });
  const { bottom, top } = extent({ values: [1.6, 1.7], bands: [] });
  assert(bottom > 1 && bottom < 1.6 && top > 1.7);
  assert.equal(extent({ values: [1.6, 1.7], bands }).bottom, 0);
  assert.deepEqual(extent({ values: [0, 0], bands: [] }), { bottom: 0, top: 1 });
});

test("ranges and deviations in words", () => {
  assert.equal(range({ low: 7.41, high: 9.21, value: 8.31 }), "7.41 to 9.21");
  assert.equal(range({ low: 20, high: null, value: null }), "at least 20");
  assert.equal(range({ high: 35, value: null }), "at most 35");
  assert.equal(range({ value: 4.02 }), "4.02");
  assert.equal(range({}), "–");
  assert.deepEqual([0.874, -9.62, 0.01, null].map(deviation), ["+0.9 SD", "−9.6 SD", "±0.0 SD", undefined]);
});

test("quantities are named as the service names them", () => {
  const rows = readFileSync("../crates/surface/src/measure/morphometry/quantity.rs", "utf8").matchAll(/^ {4}"(\w+)", "([^"]+)", "([^"]*)", \|m\|/gm);
  const listed = Array.from(rows, ([, name, title, unit]) => ({ name: name!, title: title!, unit: unit! }));
  assert(listed.length > 30);
  for (const { name, title, unit } of listed) assert.deepEqual(quantity(name), { title, unit });
  assert.deepEqual(quantity("of_a_later_version"), { title: "of_a_later_version", unit: "" });
});
