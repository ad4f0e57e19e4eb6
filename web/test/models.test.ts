// The store of models, without a service.
import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { effect } from "@preact/signals";
import type { ModelEvent, ModelState } from "oviduct-client";
import { changes, forget, KEPT, known, receive, remember, reset, sections, state } from "../src/models.ts";

/** Ids in the order of acceptance. */
const id = (number: number) => `0197c000-0000-7000-8000-${String(number).padStart(12, "0")}`;

function model(number: number, changed: Partial<ModelState> = {}): ModelState {
  return {
    id: id(number), status: "running", version: 1, preset: "pig", seed: number, outputs: ["glb"], bodies: ["tissue"], labels: {}, priority: 0,
    backend: { requested: "auto" }, queue: {}, attempts: 1, created_at: "2026-02-08T09:14:00Z", files: [], warnings: [], digest: "",
    ...changed,
  };
}

function section(number: number, index: number): ModelEvent {
  const square: [number, number][] = [[0, 0], [1, 0], [1, 1], [0, 1]];
  return { type: "section", id: "", model: model(number, { section: { index, step: index, z_um: index, inner: square, outer: square } }) };
}

const gathered = () => new Promise((resolve) => setTimeout(resolve, 80));
const indices = (number: number) => sections(id(number)).value.map(({ index }) => index);

beforeEach(reset);

test("an older state does not replace a newer one, an equal version does", () => {
  remember([model(1, { version: 3, status: "queued", queue: { position: 5 } })]);
  remember([model(1, { version: 2, status: "running" })]);
  assert.equal(state(id(1)).value?.status, "queued");
  remember([model(1, { version: 3, status: "queued", queue: { position: 4 } })]);
  assert.equal(state(id(1)).value?.queue.position, 4);
});

test("models are known newest first", () => {
  remember([model(2), model(3), model(1)]);
  assert.deepEqual([...known()].map(({ seed }) => seed), [3, 2, 1]);
});

test("models stay in order as they come and go", () => {
  for (const number of [5, 1, 9, 3, 7, 4]) remember([model(number)]);
  remember([model(3, { version: 2 })]);
  forget(id(9));
  forget(id(4));
  assert.deepEqual([...known()].map(({ seed }) => seed), [7, 5, 3, 1]);
});

test("changes counts arrivals, ends and departures, not progress", () => {
  const before = changes.value;
  remember([model(1)]);
  remember([model(1, { version: 2 })]);
  assert.equal(changes.value - before, 1);
  remember([model(1, { version: 3, status: "failed" })]);
  forget(id(1));
  assert.equal(changes.value - before, 3);
});

test("a deleted model does not come back with an answer that was on its way", async () => {
  remember([model(1)]);
  const held = state(id(1));
  receive({ type: "end", id: "", model: { id: id(1), status: "deleted" } });
  await gathered();
  assert.equal(held.value, undefined);
  remember([model(1, { version: 9 })]);
  receive(section(1, 4));
  await gathered();
  assert.deepEqual([[...known()], indices(1)], [[], []]);
});

test("a model that starts again from a checkpoint repeats its sections", async () => {
  for (const index of [10, 20, 30, 20]) receive(section(1, index));
  await gathered();
  assert.deepEqual(indices(1), [10, 20]);
  assert.deepEqual([...sections(id(1)).value[0]!.inner!], [0, 0, 1, 0, 1, 1, 0, 1]);
  assert.equal(state(id(1)).value && "section" in state(id(1)).value!, false);
});

test("events that come together are shown together", async () => {
  let drawn = 0;
  const stop = effect(() => {
    void changes.value;
    drawn++;
  });
  for (let k = 1; k <= 100; k++) receive({ type: "status", id: "", model: model(k) });
  await gathered();
  stop();
  assert.equal([...known()].length, 100);
  assert.equal(drawn, 2);
});

test("the sections of growing models are kept, and those of few ended ones", async () => {
  for (let k = 1; k <= 20; k++) receive(section(k, 1));
  await gathered();
  for (let k = 1; k <= 10; k++) remember([model(k, { version: 2, status: "succeeded" })]);
  receive(section(20, 2));
  await gathered();
  const kept = Array.from({ length: 20 }, (_, k) => k + 1).filter((k) => indices(k).length > 0);
  assert.deepEqual(kept, [7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20]);
});

test("of many models those are dropped that are not shown and were touched least recently", () => {
  const numbers = Array.from({ length: KEPT }, (_, k) => k + 1);
  remember(numbers.map((number) => model(number)));
  const shown = state(id(1));
  const stop = effect(() => void shown.value);
  remember([model(2, { version: 2 })]);
  remember(Array.from({ length: 3 }, (_, k) => model(KEPT + 1 + k)));
  const seeds = [...known()].map(({ seed }) => seed).reverse();
  assert.deepEqual([seeds.length, ...seeds.slice(0, 3)], [KEPT, 1, 2, 6]);
  remember([model(1, { version: 2, status: "succeeded" })]);
  assert.equal(shown.value?.status, "succeeded");
  // The model is not shown and is the least recently used one.
  stop();
  remember([...known()].filter(({ seed }) => seed !== 1));
  remember([model(KEPT + 4)]);
  assert(![...known()].some(({ seed }) => seed === 1));
  // It can be read again.
  remember([model(1)]);
  assert.equal([...known()].at(-1)?.seed, 1);
});

test("another key begins with nothing, even of events that wait", async () => {
  remember([model(1)]);
  const held = state(id(1));
  receive({ type: "status", id: "", model: model(2) });
  reset();
  await gathered();
  assert.deepEqual([[...known()], held.value], [[], undefined]);
});
