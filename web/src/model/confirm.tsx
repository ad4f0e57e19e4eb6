// Asks for confirmation of an action that cannot be undone.
import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import { Dialog } from "../ui/widgets.tsx";

interface Props {
  title: string;
  /** Text of the confirming button. */
  action: string;
  children: ComponentChildren;
  /** True while the button is disabled, for example until the consequence is known. */
  disabled?: boolean;
  /** Runs the action; the dialog closes afterwards. */
  onConfirm: () => Promise<unknown>;
  onClose: () => void;
}

export function Confirm({ title, action, children, disabled = false, onConfirm, onClose }: Props) {
  const [busy, setBusy] = useState(false);
  const confirm = async (close: () => void) => {
    setBusy(true);
    await onConfirm();
    close();
  };
  return (
    <Dialog title={title} onClose={onClose}>
      {(close) => (
        <div class="confirm">
          {children}
          <div class="row">
            <button type="button" class="button button-danger" disabled={disabled || busy} onClick={() => confirm(close)}>{action}</button>
            <button type="button" class="button" onClick={close}>Keep</button>
          </div>
        </div>
      )}
    </Dialog>
  );
}
