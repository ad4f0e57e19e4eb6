// The decoder against frames of the reference implementation, and against damage.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { test } from "node:test";
import { decompress } from "../dist/zstd.js";

/** Numbers that look random, the same in each run (mulberry32). */
function random(seed: number): () => number {
  return () => {
    seed = (seed + 0x6d2b79f5) | 0;
    let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}

function bytes(length: number, byte: (i: number) => number): Buffer {
  return Buffer.from(Uint8Array.from({ length }, (_, i) => byte(i)));
}

const next = random(1);
const words = Array.from({ length: 300 }, () => Math.floor(next() * 2 ** 40).toString(36));
const text = Array.from({ length: 60_000 }, () => words[Math.floor(next() ** 3 * words.length)]).join(" ");
const SAMPLES: Record<string, Buffer> = {
  empty: Buffer.alloc(0),
  byte: Buffer.from("x"),
  zeros: Buffer.alloc(400_000),
  noise: bytes(300_000, () => next() * 256),
  skewed: bytes(200_000, () => next() ** 6 * 256),
  few: bytes(5000, () => 97 + next() ** 2 * 4),
  text: Buffer.from(text),
  ramps: bytes(150_000, (i) => (i * i) >> 9),
  mixed: Buffer.concat([Buffer.from(text.slice(0, 3000)), bytes(3000, () => next() * 256), Buffer.alloc(140_000, "ab")]),
};

function compress(data: Buffer, ...options: string[]): Uint8Array {
  return execFileSync("zstd", ["--quiet", "--stdout", ...options], { input: data, maxBuffer: 2 ** 26 });
}

for (const [name, data] of Object.entries(SAMPLES)) {
  test(`${name} is as it was`, () => {
    const levels = ["-1", "-3", "-7", "-12", "-19", "--ultra -22", "--fast=5", "-5 --no-check"];
    for (const level of [...levels, `-9 --stream-size=${data.length}`]) {
      const back = decompress(compress(data, ...level.split(" ")), data.length);
      assert(Buffer.compare(back, data) === 0, level);
    }
  });
}

test("small inputs of all lengths are as they were", () => {
  for (let length = 0; length < 300; length += 7) {
    const data = Buffer.from(text.slice(length, 3 * length));
    assert(Buffer.compare(decompress(compress(data, "-19"), data.length), data) === 0, String(length));
  }
});

test("damage is an error, or gives other bytes of the expected number", () => {
  const data = SAMPLES["text"]!.subarray(0, 20_000);
  const frame = compress(data, "-19", "--no-check");
  const draw = random(2);
  let errors = 0;
  for (let round = 0; round < 2000; round++) {
    const broken = frame.slice(0, round % 4 ? frame.length : Math.floor(draw() * frame.length));
    for (let i = 0; i < 1 + (round % 3); i++) broken[Math.floor(draw() * broken.length)] = draw() * 256;
    try {
      assert.equal(decompress(broken, data.length).length, data.length);
    } catch (error) {
      assert.match((error as Error).message, /^the Zstandard frame is damaged: /);
      errors++;
    }
  }
  assert(errors > 1000, String(errors));
  assert.throws(() => decompress(frame, data.length - 1), /damaged/);
  assert.throws(() => decompress(frame, data.length + 1), /damaged/);
  assert.throws(() => decompress(new Uint8Array(), 0), /damaged/);
});
