// Dialog that asks for an API key.
import { effect, signal } from "@preact/signals";
import { useId, useRef, useState } from "preact/hooks";
import { Oviduct } from "oviduct-client";
import { base, explain, key, locked, setKey } from "./service.ts";
import { Dialog } from "./ui/widgets.tsx";

/**
 * True while the dialog is open. It opens when the service requires an API key, and can be closed.
 */
export const askingForKey = signal(false);
effect(() => {
  if (locked.value !== undefined) askingForKey.value = true;
});

export function KeyDialog() {
  const input = useRef<HTMLInputElement>(null);
  const [fault, setFault] = useState(locked.value === "refused" ? "The service no longer accepts the key." : "");
  const [busy, setBusy] = useState(false);
  const [field, hint] = [useId(), useId()];
  const submit = async (event: Event, close: () => void) => {
    event.preventDefault();
    const value = input.current?.value.trim() ?? "";
    if (value === "") return setFault("Enter a key.");
    setBusy(true);
    try {
      await new Oviduct(base, { key: value, attempts: 2 }).presets();
      close();
      setKey(value);
    } catch (error) {
      setFault(explain(error));
    } finally {
      setBusy(false);
    }
  };
  const forget = (close: () => void) => {
    close();
    setKey(undefined);
  };
  return (
    <Dialog title="Key" onClose={() => (askingForKey.value = false)}>
      {(close) => (
        <form class="field" onSubmit={(event) => submit(event, close)}>
          <label for={field}>Key of this service</label>
          <input ref={input} id={field} type="password" autocomplete="off" spellcheck={false} aria-describedby={hint} aria-invalid={fault !== ""} />
          {fault !== "" && <p class="fault" role="alert">{fault}</p>}
          <p id={hint} class="hint">It is kept in this tab and sent to this service only. On a shared computer, forget it when you are done.</p>
          <div class="row">
            <button type="submit" class="button button-primary" disabled={busy}>Use this key</button>
            {key.value !== undefined && <button type="button" class="button" onClick={() => forget(close)}>Forget the key</button>}
          </div>
        </form>
      )}
    </Dialog>
  );
}
