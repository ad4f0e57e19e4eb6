// Mouse, touch and keyboard input on the picture of a model or of a section.

/** Actions on a picture; distances in pixels of the page. */
export interface Actions {
  turn(right: number, down: number): void;
  pan(right: number, down: number): void;
  /** Factors above 1 zoom out; (x, y) is the position of the wheel or the middle of two fingers. */
  zoom(factor: number, x: number, y: number): void;
  tap(x: number, y: number): void;
  /** Handles a key; returns true if the key has a function. */
  key?(key: string, shift: boolean): boolean;
}

/** Maximum movement of a tap, pixels. */
const TAP = 6;

interface Pointer {
  x: number;
  y: number;
}

/**
 * Listens on an element until the signal is aborted. Positions are from the element's top left
 * corner.
 */
export function control(element: GlobalEventHandlers & Element, actions: Actions, signal: AbortSignal): void {
  const pointers = new Map<number, Pointer>();
  let moved = 0;
  // The offsets of an event refer to its target, which may be a child of the element.
  const at = (event: MouseEvent): Pointer => {
    const { left, top } = element.getBoundingClientRect();
    return { x: event.clientX - left, y: event.clientY - top };
  };
  const options = { signal };

  element.addEventListener(
    "pointerdown",
    (event) => {
      if (pointers.size === 0) moved = 0;
      // Two fingers are not a tap.
      else moved = Infinity;
      pointers.set(event.pointerId, at(event));
      element.setPointerCapture(event.pointerId);
    },
    options,
  );

  element.addEventListener(
    "pointermove",
    (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const now = at(event);
      const [dx, dy] = [now.x - before.x, now.y - before.y];
      moved += Math.hypot(dx, dy);
      const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
      pointers.set(event.pointerId, now);
      if (other) {
        const [was, is] = [Math.hypot(before.x - other.x, before.y - other.y), Math.hypot(now.x - other.x, now.y - other.y)];
        if (was > 0 && is > 0) actions.zoom(was / is, (before.x + other.x) / 2, (before.y + other.y) / 2);
        // Each finger moves the middle by half of its movement.
        actions.pan(dx / 2, dy / 2);
      } else if (moved > TAP) {
        const panning = event.shiftKey || event.ctrlKey || (event.buttons & 6) !== 0;
        if (panning) actions.pan(dx, dy);
        else actions.turn(dx, dy);
      }
    },
    options,
  );

  const end = (event: PointerEvent) => {
    if (!pointers.delete(event.pointerId)) return;
    if (event.type !== "pointerup" || event.button !== 0 || moved > TAP) return;
    const { x, y } = at(event);
    actions.tap(x, y);
  };
  element.addEventListener("pointerup", end, options);
  element.addEventListener("pointercancel", end, options);
  element.addEventListener("contextmenu", (event) => event.preventDefault(), options);

  element.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      // Some wheels report lines or pages.
      const pixels = event.deltaY * [1, 16, 200][event.deltaMode]!;
      const { x, y } = at(event);
      actions.zoom(Math.exp(Math.max(-120, Math.min(120, pixels)) * 0.0022), x, y);
    },
    { signal, passive: false },
  );

  element.addEventListener(
    "keydown",
    (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (actions.key?.(event.key, event.shiftKey)) event.preventDefault();
    },
    options,
  );
}
