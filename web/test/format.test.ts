import assert from "node:assert/strict";
import { test } from "node:test";
import { millimetres } from "../src/ui/format.ts";

test("lengths in models side by side are said once where they are the same", () => {
  assert.equal(millimetres([12.345]), "12.3 mm");
  assert.equal(millimetres([12.345, 12.341]), "12.3 mm");
  assert.equal(millimetres([0.75 * 60, 0.75 * 40]), "45 and 30 mm");
});
