import assert from "node:assert/strict";
import { test } from "node:test";
import type { ModelState } from "oviduct-client";
import { conditions, isEmpty, matches, readFilter, writeFilter } from "../src/list/filter.ts";

const NOW = Date.parse("2026-02-08T12:00:00Z");
const query = (text: string) => new URLSearchParams(text);
const model = (changed: Partial<ModelState>) =>
  ({ status: "running", preset: "pig", batch: null, labels: {}, created_at: "2026-02-08T11:30:00Z", ...changed }) as ModelState;
const shows = (text: string, changed: Partial<ModelState>) => matches(model(changed), conditions(readFilter(query(text)), NOW));

test("a filter survives its link", () => {
  const text = "status=failed&preset=pig&batch=0197&within=week&label=lab%3Aa%3Ab&label=n%3A1";
  const filter = readFilter(query(text));
  assert.deepEqual(filter, { status: "failed", preset: "pig", batch: "0197", within: "week", labels: ["lab:a:b", "n:1"] });
  assert.deepEqual(readFilter(writeFilter(filter)), filter);
});

test("what a link has wrong is left out", () => {
  assert.ok(isEmpty(readFilter(query("status=odd&within=year&label=nocolon&label=%3Avalue&preset="))));
});

test("of two labels of one name in a link the last one counts", () => {
  const filter = readFilter(query("label=lab:a&label=n:1&label=lab:b"));
  assert.deepEqual(filter.labels, ["n:1", "lab:b"]);
  assert.deepEqual(conditions(filter, NOW).labels, { n: "1", lab: "b" });
});

test("models match as the service judges them", () => {
  assert.ok(shows("", {}));
  assert.ok(!shows("status=failed", {}));
  assert.ok(shows("label=lab:a:b", { labels: { lab: "a:b", other: "x" } }));
  assert.ok(!shows("label=lab:a&label=n:1", { labels: { lab: "a" } }));
  assert.ok(!shows("batch=0197", { batch: "0198" }));
  assert.ok(shows("within=hour", { created_at: "2026-02-08T11:00:00Z" }));
  assert.ok(!shows("within=hour", { created_at: "2026-02-08T10:59:59Z" }));
});
