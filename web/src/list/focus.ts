import type { RefObject } from "preact";
import { useEffect, useRef } from "preact/hooks";

/** What had the focus, and where in the list; -1 for elsewhere. */
interface Place {
  element: Element;
  row: Element | null;
  index: number;
}

/**
 * Keeps keyboards in the list: when what has the focus goes, as with a deleted model, its row gets it, or the next one, or the
 * heading. Gives the listener of `focusin`.
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
