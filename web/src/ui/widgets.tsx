// Small parts that all pages use.
import { signal } from "@preact/signals";
import type { ComponentChildren } from "preact";
import { useEffect, useId, useRef } from "preact/hooks";
import type { Status } from "oviduct-client";
import { copy } from "./copy.ts";
import { ago } from "./format.ts";

/** Time for `ago`, updated twice a minute. */
export const now = signal(Date.now());
setInterval(() => (now.value = Date.now()), 30_000);

export function Ago({ time }: { time: string }) {
  return (
    <time dateTime={time} title={new Date(time).toLocaleString()}>
      {ago(time, now.value)}
    </time>
  );
}

export function StatusBadge({ status }: { status: Status }) {
  return <span class={`badge badge-${status}`}>{status}</span>;
}

/** A bar from 0 to 1. */
export function ProgressBar({ fraction, label }: { fraction: number; label: string }) {
  return <progress max={1} value={fraction} aria-label={label} />;
}

interface DialogProps {
  title: string;
  /** Called whenever the dialog closes. */
  onClose: () => void;
  /** `close` restores the previous focus; removing the dialog does not. */
  children: (close: () => void) => ComponentChildren;
}

/** A modal dialog. */
export function Dialog(props: DialogProps) {
  const dialog = useRef<HTMLDialogElement>(null);
  const close = () => dialog.current?.close();
  const title = useId();
  useEffect(() => {
    dialog.current?.showModal();
  }, []);
  return (
    <dialog ref={dialog} aria-labelledby={title} onClose={props.onClose}>
      <header class="dialog-header">
        <h2 id={title}>{props.title}</h2>
        <button type="button" class="button-icon" aria-label="Close" onClick={close}>
          <Icon name="close" />
        </button>
      </header>
      {props.children(close)}
    </dialog>
  );
}

interface Toast {
  id: number;
  text: string;
  kind: "info" | "error";
}
const toasts = signal<readonly Toast[]>([]);
let toastId = 0;

/** Shows a message for some seconds; errors stay until the user closes them. */
export function toast(text: string, kind: "info" | "error" = "info"): void {
  const id = ++toastId;
  toasts.value = [...toasts.value.slice(-3), { id, text, kind }];
  if (kind === "info") setTimeout(() => closeToast(id), 6000);
}

function closeToast(id: number): void {
  toasts.value = toasts.value.filter((toast) => toast.id !== id);
}

export function Toasts() {
  return (
    <div class="toasts" role="status" aria-live="polite">
      {toasts.value.map(({ id, text, kind }) => (
        <div key={id} class={`toast toast-${kind}`}>
          <span>{text}</span>
          <button type="button" class="button-icon" aria-label="Dismiss" onClick={() => closeToast(id)}>
            <Icon name="close" />
          </button>
        </div>
      ))}
    </div>
  );
}

/** Copies text and confirms it. */
export function CopyButton({ text, label = "Copy" }: { text: () => string; label?: string }) {
  const onClick = async () => {
    if (await copy(text())) toast("Copied.");
    else toast("The browser does not let this page copy.", "error");
  };
  return (
    <button type="button" class="button" onClick={onClick}>
      <Icon name="copy" /> {label}
    </button>
  );
}

/** A message instead of content. */
export function Notice(props: { title: string; kind?: "info" | "error"; children?: ComponentChildren }) {
  return (
    <section class={`notice notice-${props.kind ?? "info"}`} role={props.kind === "error" ? "alert" : undefined}>
      <h2>{props.title}</h2>
      {props.children}
    </section>
  );
}

/**
 * Shown instead of a part of the page whose code failed to load. Browsers do not retry a failed
 * module.
 */
export function Unloaded({ title }: { title: string }) {
  return (
    <Notice title={title} kind="error">
      <p>The service may be restarting, or may have been updated.</p>
      <p class="row"><button type="button" class="button button-primary" onClick={() => location.reload()}>Reload the page</button></p>
    </Notice>
  );
}

// Strokes on a grid of 24.
const ICONS = {
  close: "M6 6l12 12M18 6L6 18",
  copy: "M9 9h11v11H9zM5 15H4V4h11v1",
  plus: "M12 5v14M5 12h14",
  dice: "M7 3h10a4 4 0 0 1 4 4v10a4 4 0 0 1-4 4H7a4 4 0 0 1-4-4V7a4 4 0 0 1 4-4zM8 8.5a.5.5 0 1 0 1 0 .5.5 0 1 0-1 0M15 8.5a.5.5 0 1 0 1 0 .5.5 0 1 0-1 0M11.5 12a.5.5 0 1 0 1 0 .5.5 0 1 0-1 0M8 15.5a.5.5 0 1 0 1 0 .5.5 0 1 0-1 0M15 15.5a.5.5 0 1 0 1 0 .5.5 0 1 0-1 0",
  trash: "M4 7h16M9 7V4h6v3M6 7l1 13h10l1-13",
  retry: "M4 12a8 8 0 1 0 2.5-5.8M4 4v5h5",
  stop: "M6 6h12v12H6z",
  play: "M7 4l13 8-13 8z",
  pause: "M7 5v14M17 5v14",
  download: "M12 4v11M7 11l5 5 5-5M4 20h16",
  link: "M10 14a4 4 0 0 0 6 0l3-3a4 4 0 0 0-6-6l-1 1M14 10a4 4 0 0 0-6 0l-3 3a4 4 0 0 0 6 6l1-1",
  key: "M14 10a4 4 0 1 1-4-4 4 4 0 0 1 4 4zM13 13l7 7M17 17l2-2",
  auto: "M12 3a9 9 0 1 0 0 18 9 9 0 0 0 0-18zM12 3v18M12 8h7M12 12h9M12 16h7",
  sun: "M12 8a4 4 0 1 0 0 8 4 4 0 0 0 0-8zM12 2v3M12 19v3M2 12h3M19 12h3M5 5l2 2M17 17l2 2M5 19l2-2M17 7l2-2",
  moon: "M20 14A8 8 0 0 1 10 4a8 8 0 1 0 10 10z",
  ruler: "M4 15L15 4l5 5L9 20zM8 11l2 2M11 8l2 2M14 5l2 2",
  compare: "M4 5h7v14H4zM13 5h7v14h-7z",
  cut: "M4 4h16v16H4zM4 20L20 4",
  eye: "M2 12s4-7 10-7 10 7 10 7-4 7-10 7S2 12 2 12zM12 9a3 3 0 1 0 0 6 3 3 0 0 0 0-6z",
  plane: "M3 12l18-8-6 17-3-7z",
  reset: "M4 10V4h6M20 14v6h-6M4 4l6 6M20 20l-6-6",
  pencil: "M4 20l1-5L16 4l4 4L9 19zM13 7l4 4",
  more: "M5 12v.01M12 12v.01M19 12v.01",
} as const;
export type IconName = keyof typeof ICONS;

export function Icon({ name }: { name: IconName }) {
  return (
    <svg class="icon" viewBox="0 0 24 24" aria-hidden="true">
      <path d={ICONS[name]} />
    </svg>
  );
}

