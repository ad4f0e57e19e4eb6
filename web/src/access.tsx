// Asks for a key.
import { useId, useRef, useState } from "preact/hooks";
import { Oviduct } from "oviduct-client";
import { base, explain, key, locked, setKey } from "./service.ts";
import { Dialog } from "./ui/widgets.tsx";

export function KeyDialog({ onClose }: { onClose: () => void }) {
  const input = useRef<HTMLInputElement>(null);
  const [fault, setFault] = useState(locked.value === "refused" ? "The service no longer accepts the key." : "");
  const [busy, setBusy] = useState(false);
  const [field, hint] = [useId(), useId()];
  const submit = async (event: Event) => {
    event.preventDefault();
    const value = input.current?.value.trim() ?? "";
    if (value === "") return setFault("Enter a key.");
    setBusy(true);
    try {
      await new Oviduct(base, { key: value, attempts: 2 }).presets();
      setKey(value);
      onClose();
    } catch (error) {
      setFault(explain(error));
    } finally {
      setBusy(false);
    }
  };
  const forget = () => {
    setKey(undefined);
    onClose();
  };
  return (
    <Dialog title="Key" onClose={onClose}>
      <form class="field" onSubmit={submit}>
        <label for={field}>Key of this service</label>
        <input ref={input} id={field} type="password" autocomplete="off" spellcheck={false} aria-describedby={hint} aria-invalid={fault !== ""} />
        {fault !== "" && <p class="fault" role="alert">{fault}</p>}
        <p id={hint} class="hint">It is kept in this tab until you close it, and sent to this service only.</p>
        <div class="row">
          <button type="submit" class="button button-primary" disabled={busy}>Use this key</button>
          {key.value !== undefined && <button type="button" class="button" onClick={forget}>Forget the key</button>}
        </div>
      </form>
    </Dialog>
  );
}
