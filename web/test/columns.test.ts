import assert from "node:assert/strict";
import { test } from "node:test";
import type { Table } from "oviduct-client";
import { columns, pairs, parameter, readOrder, sorted, ticks, writeOrder } from "../src/batches/columns.ts";

const schema = {
  properties: {
    friction: { title: "Friction", "x-unit": "1/step" },
    collision: { title: "Self-intersection force", properties: { gap_um: { title: "Lumen gap", "x-unit": "µm" } } },
  },
};
const table: Table = {
  columns: ["id", "status", "seed", "/collision/gap_um", "/solver/integrator", "problem", "summary.min_gap_um", "summary.volume_mm3"],
  rows: [
    ["a", "succeeded", 10, 30, "rk4", null, 4, 58],
    ["b", "failed", 9, 25, "euler", "certificate", null, null],
    ["c", "succeeded", 100, { keys: [[0, 25], [1, 30]] }, "rk4", null, 5, 57],
  ],
};
const ids = (order: string) => sorted(table, readOrder(order)).map(([id]) => id).join("");

test("parameters are named by the schema", () => {
  assert.deepEqual(parameter(schema, "/friction"), { title: "Friction", unit: "1/step" });
  assert.deepEqual(parameter(schema, "/collision/gap_um"), { title: "Lumen gap", unit: "µm" });
  assert.deepEqual(parameter(schema, "/collision/gap_um/keys"), { title: "Lumen gap keys" });
  assert.deepEqual(parameter(undefined, "/collision/gap_um"), { title: "collision gap_um" });
});

test("columns are the seed, what was varied, and the figures that exist", () => {
  const { seed, varied, figures } = columns(table, schema);
  assert.equal(seed.at, 2);
  assert.deepEqual(varied.map(({ title, at }) => [title, at]), [["Lumen gap", 3], ["solver integrator", 4]]);
  assert.deepEqual(figures.map(({ title, at }) => [title, at]), [["Tissue volume", 7], ["Smallest gap", 6]]);
});

test("rows are sorted by value, those without one last", () => {
  assert.equal(ids("seed"), "bac");
  assert.equal(ids("-seed"), "cab");
  assert.equal(ids("summary.volume_mm3"), "cab");
  assert.equal(ids("-summary.volume_mm3"), "acb");
  assert.equal(ids("/solver/integrator"), "bac");
  assert.equal(ids("unknown"), "abc");
  assert.equal(writeOrder(readOrder("-seed")!), "-seed");
});

test("a plot has the rows that have both numbers", () => {
  const { varied, figures } = columns(table, schema);
  assert.deepEqual(pairs(table, varied[0]!, figures[0]!), [{ id: "a", x: 30, y: 58 }]);
});

test("ticks are round and within the range", () => {
  assert.deepEqual(ticks(24, 51, 6), [25, 30, 35, 40, 45, 50]);
  assert.deepEqual(ticks(0.247, 0.303, 6), [0.25, 0.26, 0.27, 0.28, 0.29, 0.3]);
  assert.deepEqual(ticks(-3, 8, 2), [0]);
});
