// Mouse, touch and keyboard on a picture: of a model, of a section.

/** What is done to a picture; distances in pixels of the page. */
export interface Actions {
  turn(right: number, down: number): void;
  pan(right: number, down: number): void;
  /** Above 1 moves away; (x, y) is where the wheel is turned, or the middle of two fingers. */
  zoom(factor: number, x: number, y: number): void;
  tap(x: number, y: number): void;
  /** Whether the key was used. */
  key?(key: string, shift: boolean): boolean;
}

/** Pixels that a finger or mouse may move in a tap. */
const TAP = 6;

interface Pointer {
  x: number;
  y: number;
}

/** Listens on an element until the signal is aborted. Positions are from its top left corner. */
export function control(element: GlobalEventHandlers & Element, actions: Actions, signal: AbortSignal): void {
  const pointers = new Map<number, Pointer>();
  let moved = 0;
  // The offsets of an event are those of its target, which may lie within the element.
  const at = (event: MouseEvent): Pointer => {
    const { left, top } = element.getBoundingClientRect();
    return { x: event.clientX - left, y: event.clientY - top };
  };
  const options = { signal };

  element.addEventListener(
    "pointerdown",
    (event) => {
      if (pointers.size === 0) moved = 0;
      // A second finger makes it no tap.
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
        // Each finger moves the middle by half.
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
      // Lines and pages are some wheels' units.
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
