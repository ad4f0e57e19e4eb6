// Pages are fragments of one URL, so that any prefix of a proxy works: `#/models/0197…?at=120`.
import { signal } from "@preact/signals";

export interface Route {
  /** Segments of the path; none for the first page. */
  path: string[];
  query: URLSearchParams;
}

/** The part of the address that `route` was read from. */
let seen = location.hash;
export const route = signal(parse(seen));

addEventListener("hashchange", read);

function read(): void {
  seen = location.hash;
  route.value = parse(seen);
}

function parse(hash: string): Route {
  const [path = "", query = ""] = hash.replace(/^#\/?/, "").split("?", 2);
  return { path: path.split("/").filter(Boolean).map(decode), query: new URLSearchParams(query) };
}

function decode(segment: string): string {
  try {
    return decodeURIComponent(segment);
  } catch {
    return segment;
  }
}

/** The address of a page, for `href`. */
export function href(path: string[], query?: URLSearchParams | Record<string, string>): string {
  const search = new URLSearchParams(query).toString();
  return `#/${path.map(encodeURIComponent).join("/")}${search && `?${search}`}`;
}

export function go(path: string[], query?: URLSearchParams | Record<string, string>): void {
  location.hash = href(path, query);
}

/** Names the page in the window and in the history. */
export function setTitle(title: string): void {
  document.title = `${title} · oviduct`;
}

/** Changes the query of the present page without a new entry in the history, so that its link restores the view. */
export function setQuery(query: URLSearchParams | Record<string, string>): void {
  // A link was opened meanwhile, whose event is still to come: the address is no longer that of this page.
  if (location.hash !== seen) return;
  const target = href(route.value.path, query);
  if (target === seen) return;
  history.replaceState(history.state, "", target);
  read();
}

/** Milliseconds without a change after which a query that changes often is written. */
const SETTLED = 300;
let waiting: { query: () => URLSearchParams; timer: ReturnType<typeof setTimeout> } | undefined;

/** Changes the query once it has not been asked for a while; the newest one counts. */
export function setQuerySoon(query: () => URLSearchParams): void {
  clearTimeout(waiting?.timer);
  waiting = { query, timer: setTimeout(writeQuery, SETTLED) };
}

/** Forgets what `setQuerySoon` has not written yet. */
export function keepQuery(): void {
  clearTimeout(waiting?.timer);
  waiting = undefined;
}

function writeQuery(): void {
  const query = waiting?.query;
  keepQuery();
  if (query) setQuery(query());
}

/** The link to what is shown now. */
export function link(): string {
  writeQuery();
  return location.href;
}
