import assert from "node:assert/strict";
import { test } from "node:test";
import { settle } from "../src/list/settle.ts";

test("all are tried, a few at a time, and those that failed are told", async () => {
  const done: number[] = [];
  let [running, most] = [0, 0];
  const failed = await settle([...Array(50).keys()], async (k) => {
    most = Math.max(most, ++running);
    await new Promise((resolve) => setTimeout(resolve, 1));
    running--;
    if (k % 20 === 7) throw new Error(`no ${k}`);
    done.push(k);
  });
  assert.deepEqual(failed.map(({ one, error }) => [one, String(error)]), [[7, "Error: no 7"], [27, "Error: no 27"], [47, "Error: no 47"]]);
  assert.equal(done.length, 47);
  assert.equal(most, 3);
});
