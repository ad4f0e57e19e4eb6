// Keeps the view in the link of the page.
import { effect } from "@preact/signals";
import { keepQuery, route, setQuerySoon } from "../router.ts";
import { readSpot, writeSpot, type Measurement } from "./measure.ts";
import { readView, writeView, type View } from "./view.ts";

/**
 * Restores the view from the link and writes changes to the link, until the returned function is
 * called.
 */
export function keepLink(view: View, measurement?: Measurement): () => void {
  const read = () => {
    readView(view, route.peek().query);
    if (!measurement) return;
    measurement.a.value = readSpot(route.peek().query.get("from"));
    measurement.b.value = readSpot(route.peek().query.get("to"));
  };
  read();
  let first = true;
  const leave = effect(() => {
    view.subscribe();
    void measurement?.a.value;
    void measurement?.b.value;
    if (!first) setQuerySoon(() => queryOf(view, measurement));
    first = false;
  });
  // Another link to the same page was opened.
  addEventListener("hashchange", read);
  return () => {
    keepQuery();
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
