// Keeps what is shown in the link of the page.
import { effect } from "@preact/signals";
import { route, setQuery } from "../router.ts";
import { readSpot, writeSpot, type Measurement } from "./measure.ts";
import { readView, writeView, type View } from "./view.ts";

/** Milliseconds without a change after which the link is written. */
const SETTLED = 300;

/** Restores the view from the link, and writes it there until the function that is returned is called. */
export function keepLink(view: View, measurement?: Measurement): () => void {
  const read = () => {
    readView(view, route.peek().query);
    if (!measurement) return;
    measurement.a.value = readSpot(route.peek().query.get("from"));
    measurement.b.value = readSpot(route.peek().query.get("to"));
  };
  read();
  let [timer, first] = [0, true];
  const write = () => setQuery(queryOf(view, measurement));
  const leave = effect(() => {
    view.subscribe();
    void measurement?.a.value;
    void measurement?.b.value;
    clearTimeout(timer);
    if (!first) timer = setTimeout(write, SETTLED);
    first = false;
  });
  // Another link to the same page was opened.
  addEventListener("hashchange", read);
  return () => {
    clearTimeout(timer);
    removeEventListener("hashchange", read);
    leave();
  };
}

function queryOf(view: View, measurement: Measurement | undefined): URLSearchParams {
  const query = writeView(view, route.peek().query);
  query.delete("from");
  query.delete("to");
  if (measurement?.a.value) query.set("from", writeSpot(measurement.a.value));
  if (measurement?.b.value) query.set("to", writeSpot(measurement.b.value));
  return query;
}
