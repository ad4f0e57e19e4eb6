// Dark or light theme: that of the system, unless the user chooses one.
import { effect, signal } from "@preact/signals";

const THEMES = ["auto", "light", "dark"] as const;
export type Theme = (typeof THEMES)[number];
const STORED = "oviduct-theme";

export const theme = signal<Theme>(stored());
const system = matchMedia("(prefers-color-scheme: dark)");
/** True if the page is dark; for parts that CSS does not style. */
export const dark = signal(system.matches);

function stored(): Theme {
  try {
    return THEMES.find((name) => name === localStorage.getItem(STORED)) ?? "auto";
  } catch {
    return "auto";
  }
}

export function nextTheme(): void {
  theme.value = THEMES[(THEMES.indexOf(theme.value) + 1) % THEMES.length]!;
  try {
    localStorage.setItem(STORED, theme.value);
  } catch {
    // Storage is blocked; the choice lasts until the page is left.
  }
}

const apply = () => {
  if (theme.value === "auto") delete document.documentElement.dataset["theme"];
  else document.documentElement.dataset["theme"] = theme.value;
  dark.value = theme.value === "auto" ? system.matches : theme.value === "dark";
};
effect(apply);
system.addEventListener("change", apply);

/** True if the user prefers reduced motion. */
export const stillness = signal(false);
const reduce = matchMedia("(prefers-reduced-motion: reduce)");
const note = () => (stillness.value = reduce.matches);
note();
reduce.addEventListener("change", note);
