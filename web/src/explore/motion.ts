import { stillness } from "../ui/theme.ts";

/** When a movement of the camera begins; undefined if the user asks for less motion. */
export function glideFrom(): number | undefined {
  return stillness.peek() ? undefined : performance.now();
}
