// The request of the form as programs, in tabs.
import { signal } from "@preact/signals";
import { base, key } from "../service.ts";
import { CopyButton } from "../ui/widgets.tsx";
import { snippets, type Snippet } from "./snippets.ts";
import { request } from "./state.ts";

const NAMES: readonly Snippet["name"][] = ["curl", "Python", "TypeScript", "JSON"];
const shown = signal<Snippet["name"]>("curl");

export function CodePanel() {
  const present = request.value;
  const code =
    present && !Array.isArray(present)
      ? snippets(present, base.href, key.value !== undefined).find(({ name }) => name === shown.value)?.code
      : undefined;
  const turn = (event: KeyboardEvent) => {
    const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (by === undefined) return;
    shown.value = NAMES[(NAMES.indexOf(shown.value) + by + NAMES.length) % NAMES.length]!;
    document.getElementById(`tab-${shown.value}`)?.focus();
  };
  return (
    <>
      <div class="tabs">
        <div role="tablist" aria-label="Language" onKeyDown={turn}>
          {NAMES.map((name) => (
            <button
              key={name}
              id={`tab-${name}`}
              type="button"
              role="tab"
              aria-selected={name === shown.value}
              aria-controls="code-panel"
              tabIndex={name === shown.value ? 0 : -1}
              onClick={() => (shown.value = name)}
            >
              {name}
            </button>
          ))}
        </div>
        {code !== undefined && <CopyButton text={() => code} />}
      </div>
      <div id="code-panel" role="tabpanel" aria-labelledby={`tab-${shown.value}`}>
        {code === undefined ? <p class="soft">Correct the marked values first.</p> : <pre tabIndex={0}>{code}</pre>}
      </div>
    </>
  );
}
