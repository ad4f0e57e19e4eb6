import type { RefObject } from "preact";
import { useEffect, useRef } from "preact/hooks";

/** The focused element and its place in the list; -1 outside the list. */
interface Place {
  element: Element;
  row: Element | null;
  index: number;
}

/**
 * Keeps the focus in the list when the focused element disappears, for example with a deleted
 * model.
 *
 * Then its row, the next row, or the heading gets the focus. Returns the listener of `focusin`.
 */
export function useKeptFocus(heading: RefObject<HTMLElement | null>, list: RefObject<HTMLElement | null>) {
  const place = useRef<Place>(null);
  useEffect(() => {
    const last = place.current;
    const rows = list.current?.children;
    if (!last || !rows) return;
    if (last.row?.isConnected) last.index = [...rows].indexOf(last.row);
    if (last.element.isConnected || document.activeElement !== document.body) return;
    place.current = null;
    const row = last.row?.isConnected ? last.row : rows[Math.min(last.index, rows.length - 1)];
    (row?.querySelector<HTMLElement>("h2 a") ?? heading.current)?.focus();
  });
  return (event: FocusEvent) => {
    const element = event.target as Element;
    const row = element.closest(".models > li");
    place.current = { element, row, index: row ? [...row.parentElement!.children].indexOf(row) : -1 };
  };
}
