// The style sheets of pages are loaded on the first visit and stay loaded, so no sheet may depend
// on their order.
import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { test } from "node:test";

/**
 * The first sheet. Its classes are for all pages, which may change them together with their own
 * classes.
 */
const SHARED = "ui/theme.css";

/** The classes of each selector in a sheet, including the surrounding rules. */
function selectors(css: string): string[][] {
  const around: string[][][] = [];
  const found: string[][] = [];
  for (const [, before, end] of css.replace(/\/\*.*?\*\/|"[^"]*"/gs, "").matchAll(/([^{};]*)([{};])/g)) {
    if (end === "}") around.pop();
    if (end !== "{") continue;
    const outer = around.at(-1) ?? [[]];
    const own = before!.trim().startsWith("@") ? [[]] : before!.split(",").map((selector) => selector.match(/\.[a-z][\w-]*/gi) ?? []);
    around.push(outer.flatMap((classes) => own.map((more) => [...classes, ...more])));
    found.push(...around.at(-1)!);
  }
  return found;
}

test("a class that a style sheet defines is not in another one", () => {
  const names = readdirSync("src", { recursive: true, encoding: "utf8" }).filter((name) => name.endsWith(".css"));
  const sheets = names.map((name) => {
    const all = selectors(readFileSync(`src/${name}`, "utf8"));
    return { name, used: new Set(all.flat()), defined: new Set(all.filter(({ length }) => length === 1).flat()) };
  });
  assert(sheets.length > 5 && sheets.every(({ used }) => used.size > 0));
  const clashes = sheets.flatMap(({ name, defined }) =>
    sheets.filter((other) => other.name !== name).flatMap((other) =>
      [...(name === SHARED ? other.defined : other.used)].filter((one) => defined.has(one)).map((one) => `${one} of ${name} in ${other.name}`)));
  assert.deepEqual(clashes, []);
});

test("the shared style sheet comes first", () => {
  assert.match(readFileSync("src/main.tsx", "utf8"), /^(\/\/.*\n)*import "\.\/ui\/theme\.css";/);
});
