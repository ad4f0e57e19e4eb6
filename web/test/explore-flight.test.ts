// The flight through the lumen, without a picture.
import assert from "node:assert/strict";
import { test } from "node:test";
import { effect, signal } from "@preact/signals";

const query = Object.assign(new EventTarget(), { matches: false });
Object.assign(globalThis, { matchMedia: () => query, document: { documentElement: { dataset: {} } } });
const { Flight } = await import("../src/explore/flight.ts");
const { View } = await import("../src/explore/view.ts");

/** A way along the tube. */
const straight = (place: number, millimetres: number): number => place + millimetres;

test("a flight has the speed that it states, and tells its position now and then", () => {
  const view = new View({ begin: 0, length: 20, radius: 1, x: 0, y: 0 });
  const flight = new Flight(view, 20, signal(true), straight);
  let told = -1;
  const stop = effect(() => {
    void flight.shown.value;
    told++;
  });
  flight.start();
  flight.speed.value = 2;
  let now = 1000;
  for (; now <= 6000; now += 20) assert(flight.advance(now));
  assert(Math.abs(view.flown - 0.5) < 1e-9, `${view.flown}`);
  assert(told > 30 && told < 60, `told ${told} times`);
  assert(Math.abs(flight.shown.value - view.flown) < 0.02);

  flight.toggle();
  assert(!flight.advance(now));
  assert.equal(flight.shown.value, view.flown);
  flight.move(-5);
  assert(Math.abs(view.flown - 0.25) < 1e-9);
  // The flight does not move during a pause, nor for a second picture of the same frame.
  flight.toggle();
  flight.advance(9000);
  flight.advance(9050);
  flight.advance(9050);
  assert(Math.abs(view.flown - 0.255) < 1e-9, `${view.flown}`);

  flight.move(14);
  for (now = 10_000; flight.advance(now); now += 50);
  assert.deepEqual([view.flight.value, flight.playing.value], [1, false]);
  flight.toggle();
  assert.deepEqual([view.flown, flight.playing.value], [0, true]);
  flight.leave();
  assert.equal(flight.playing.value, false);
  stop();
  flight.dispose();
});

test("a flight moves when nothing is in its way any more, and the section follows it", () => {
  const view = new View({ begin: 0, length: 20, radius: 1, x: 0, y: 0 });
  const ready = signal(false);
  const flight = new Flight(view, 20, ready, straight);
  flight.start();
  for (let now = 1000; now < 3000; now += 50) assert(!flight.advance(now));
  ready.value = true;
  assert(flight.advance(9000) && flight.advance(9050));
  assert(Math.abs(view.flown - 0.0025) < 1e-9, `${view.flown}`);
  flight.toggle();
  assert(Math.abs(view.section.value - 0.0025) < 1e-9, `${view.section.value}`);
  flight.move(5);
  assert.equal(view.section.value, view.flight.value);
  view.goTo(0.2525);
  assert.deepEqual([view.flown, view.section.value], [0.2525, 0.2525], "the camera goes where a section is chosen");
  flight.toggle();
  for (const now of [9100, 9150]) assert(flight.advance(now));
  flight.leave();
  assert(Math.abs(view.section.value - 0.255) < 1e-9, "it stays where the flight was left");
  flight.dispose();
});
