// Pages are fragments of one URL, so they work under any prefix of a proxy:
// `#/models/0197…?at=120`.
import { signal } from "@preact/signals";

export interface Route {
  /** Segments of the path; none for the start page. */
  path: string[];
  query: URLSearchParams;
}

/** The fragment from which `route` was read. */
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

/** The fragment of a page, for `href`. */
export function href(path: string[], query?: URLSearchParams | Record<string, string>): string {
  const search = new URLSearchParams(query).toString();
  return `#/${path.map(encodeURIComponent).join("/")}${search && `?${search}`}`;
}

export function go(path: string[], query?: URLSearchParams | Record<string, string>): void {
  location.hash = href(path, query);
}

/** Sets the title of the window and of the history entry. */
export function setTitle(title: string): void {
  document.title = `${title} · oviduct`;
}

/**
 * Changes the query of the current page without a new history entry, so that its link restores the
 * view.
 */
export function setQuery(query: URLSearchParams | Record<string, string>): void {
  // Another link was opened, and its event is still to come, so the URL belongs to another page.
  if (location.hash !== seen) return;
  const target = href(route.value.path, query);
  if (target === seen) return;
  history.replaceState(history.state, "", target);
  read();
}

/** Milliseconds without a change after which a frequently changing query is written. */
const SETTLED = 300;
let waiting: { query: () => URLSearchParams; timer: ReturnType<typeof setTimeout> } | undefined;

/** Changes the query after a pause in changes; the newest query counts. */
export function setQuerySoon(query: () => URLSearchParams): void {
  clearTimeout(waiting?.timer);
  waiting = { query, timer: setTimeout(writeQuery, SETTLED) };
}

/** Discards a query that `setQuerySoon` has not written yet. */
export function keepQuery(): void {
  clearTimeout(waiting?.timer);
  waiting = undefined;
}

function writeQuery(): void {
  const query = waiting?.query;
  keepQuery();
  if (query) setQuery(query());
}

/** The link to the current view. */
export function link(): string {
  writeQuery();
  return location.href;
}
