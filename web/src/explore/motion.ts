import { stillness } from "../ui/theme.ts";

/** Start time of a camera movement; undefined if the user prefers reduced motion. */
export function glideFrom(): number | undefined {
  return stillness.peek() ? undefined : performance.now();
}
