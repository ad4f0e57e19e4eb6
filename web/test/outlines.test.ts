// Outlines of growing tubes across a reload of the page.
import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import type { ModelState } from "oviduct-client";
import { readOutlines, writeOutlines } from "../src/growing/outlines.ts";
import { remember, reset, sections, type LiveSection } from "../src/models.ts";

function grow(id: string, count: number, changed: Partial<ModelState> = {}): void {
  const model: ModelState = {
    id, status: "running", version: 1, preset: "pig", seed: 1, outputs: ["glb"], bodies: ["tissue"], labels: {}, priority: 0, backend: { requested: "auto" },
    queue: {}, attempts: 1, created_at: "2026-02-08T09:14:00Z", files: [], warnings: [], digest: "",
  };
  remember([{ ...model, ...changed }]);
  sections(id).value = Array.from({ length: count }, (_, k) => section(k));
}

/** A circle with a radius of 1,000 µm and more points than are kept. */
function section(index: number): LiveSection {
  const points = Array.from({ length: 500 }, (_, k) => (2 * Math.PI * k) / 500).flatMap((turn) => [1000 * Math.cos(turn), 1000 * Math.sin(turn)]);
  const contour = Float32Array.from(points);
  return { index, step: 5 * index, z_um: 300 * index, inner: contour, outer: contour };
}

/** Simulates a reload of the page; returns the stored text. */
function reload(): string {
  const text = writeOutlines();
  reset();
  readOutlines(text);
  return text;
}

beforeEach(reset);

test("the outline of a growing tube outlives a reload, also a second one", () => {
  grow("a", 7);
  reload();
  const first = sections("a").value;
  assert.deepEqual(first.map(({ index, step, z_um }) => [index, step, z_um]), Array.from({ length: 7 }, (_, k) => [k, 5 * k, 300 * k]));
  for (const { inner, outer } of first) {
    assert.equal(inner, undefined);
    assert.equal(outer.length, 96);
    for (let k = 0; k < 48; k++) assert(Math.abs(Math.hypot(outer[2 * k]!, outer[2 * k + 1]!) - 1000) < 4);
  }
  remember([{ id: "a", status: "running", version: 1 } as ModelState]);
  reload();
  assert.deepEqual(sections("a").value, first);
});

test("what is kept is bounded: four models that grow, 150 sections of each", () => {
  for (const id of ["a", "b", "c", "d", "e", "f"]) grow(id, 1000);
  grow("g", 3, { status: "succeeded" });
  const text = reload();
  assert(text.length < 400_000, `${text.length} characters`);
  assert.deepEqual(["a", "b", "c", "d", "e", "f", "g"].filter((id) => sections(id).value.length > 0), ["c", "d", "e", "f"]);
  const kept = sections("c").value.map(({ index }) => index);
  assert.deepEqual([kept.length, kept[0], kept.at(-1)], [150, 0, 999]);
});

test("nothing is kept when nothing grows, and what is damaged is left alone", () => {
  grow("a", 3, { status: "failed" });
  assert.equal(writeOutlines(), "");
  for (const text of ["", "{}", "[1]", '[["a"]]']) readOutlines(text);
});
