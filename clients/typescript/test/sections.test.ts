// A damaged sections.bin, and a page without hash functions. live.test.ts compares the contents of
// a valid file.
import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { Oviduct, Sections } from "oviduct-client";
import { Service, SMALL } from "./service.js";

let service: Service;
let load: () => Promise<ArrayBuffer>;
let file: Uint8Array;

before(async () => {
  service = await Service.start();
  const client = new Oviduct(service.url);
  const { id } = await client.submit({ ...SMALL, seed: 1 }, { wait: 60 });
  load = () => client.bytes(id, "sections.bin");
  file = new Uint8Array(await load());
});
after(() => service[Symbol.asyncDispose]());

test("each damaged byte is found", async () => {
  for (let at = 0; at < file.length; at += 97) {
    const broken = file.slice();
    broken[at]! ^= 1;
    await assert.rejects(Sections.parse(broken), Error, String(at));
  }
  for (const end of [0, 20, 100, file.length - 1]) await assert.rejects(Sections.parse(file.slice(0, end)), /damaged/);
});

test("a view into a larger buffer is read", async () => {
  const larger = new Uint8Array(file.length + 10);
  larger.set(file, 5);
  const sections = await Sections.parse(larger.subarray(5, 5 + file.length));
  const [own, whole] = [sections.section(1), (await Sections.parse(file)).section(1)];
  assert.deepEqual(own, whole);
});

test("without hashes the structure is checked all the same", async () => {
  const { subtle } = crypto;
  Object.defineProperty(crypto, "subtle", { value: undefined, configurable: true });
  try {
    const sections = await Sections.parse(await load());
    assert(sections.section(0).inner.x.length > 0);
    const broken = file.slice();
    broken[file.length - 64]! ^= 1;
    await assert.rejects(Sections.parse(broken), /parts do not fill it/);
  } finally {
    Object.defineProperty(crypto, "subtle", { value: subtle, configurable: true });
  }
});
