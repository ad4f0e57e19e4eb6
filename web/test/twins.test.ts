import assert from "node:assert/strict";
import { test } from "node:test";
import { shortId, twins } from "../src/list/twins.ts";

test("models of equal preset and seed are found", () => {
  const model = (id: string, preset: string, seed: number) => ({ id, preset, seed });
  const models = [model("a", "pig", 3), model("b", "pig", 4), model("c", "pig", 3), model("d", "paper", 3), model("e", "pig", 3)];
  assert.deepEqual([...twins(models)].sort(), ["a", "c", "e"]);
  assert.equal(shortId("0197c000-0000-7000-8000-0000007f3a2b"), "7f3a2b");
});
