import assert from "node:assert/strict";
import { test } from "node:test";

test("a query does not replace the address of a link that was just opened", async () => {
  const location = { hash: "#/new?seed=3" };
  let changed = () => {};
  const history = { state: null, replaceState: (_: unknown, __: string, target: string) => (location.hash = target) };
  const addEventListener = (name: string, listener: () => void) => {
    assert.equal(name, "hashchange");
    changed = listener;
  };
  Object.assign(globalThis, { location, history, addEventListener });
  const { route, setQuery } = await import("../src/router.ts");

  setQuery({});
  assert.equal(location.hash, "#/new");
  assert.equal(route.value.query.size, 0);

  location.hash = "#/new?purpose=study";
  setQuery({ seed: "4" });
  assert.equal(location.hash, "#/new?purpose=study");
  assert.equal(route.value.query.size, 0);

  changed();
  assert.equal(route.value.query.get("purpose"), "study");
  setQuery({});
  assert.equal(location.hash, "#/new");
});
