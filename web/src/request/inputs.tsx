// Parts of the form: a number that may be mistyped, a choice of a few options, a field with its
// faults.
import type { ComponentChildren } from "preact";
import { useId, useState } from "preact/hooks";
import { faults } from "./check.ts";
import { sentence } from "./faults.ts";
import { titles } from "./state.ts";
import { readNumber } from "./text.ts";

interface NumberProps {
  value: number;
  onValue: (value: number) => void;
  id?: string;
  class?: string;
  readOnly?: boolean;
  "aria-label"?: string;
  "aria-invalid"?: boolean;
  "aria-describedby"?: string | undefined;
}

/** A number input that keeps the typed text; the value is NaN while the text is not a number. */
export function NumberInput({ value, onValue, ...rest }: NumberProps) {
  const [draft, setDraft] = useState("");
  const shown = Object.is(readNumber(draft), value) ? draft : Number.isNaN(value) ? "" : String(value);
  return (
    <input
      {...rest}
      type="text"
      inputMode="decimal"
      autocomplete="off"
      value={shown}
      onInput={({ currentTarget }) => {
        setDraft(currentTarget.value);
        onValue(readNumber(currentTarget.value));
      }}
    />
  );
}

/** Text with code between backticks. */
export function Marked({ text }: { text: string }) {
  return <>{text.split("`").map((part, i) => (i % 2 === 1 ? <code key={i}>{part}</code> : part))}</>;
}

/** A choice of a few options, side by side. */
export function Segments<Name extends string>(props: {
  label: string;
  value: Name;
  choices: readonly (readonly [Name, string])[];
  onChange: (name: Name) => void;
}) {
  const name = useId();
  return (
    <div class="segments" role="radiogroup" aria-label={props.label}>
      {props.choices.map(([choice, text]) => (
        <label key={choice}>
          <input type="radio" name={name} checked={choice === props.value} onChange={() => props.onChange(choice)} />
          <span>{text}</span>
        </label>
      ))}
    </div>
  );
}

/** Id of the control that shows the faults of a pointer. */
export function controlId(pointer: string): string {
  return `field${pointer}`;
}

/** Attributes of the control of a field. */
export function controlOf(pointer: string, hinted = true) {
  const faulty = faults.value.has(pointer);
  const id = controlId(pointer);
  const described = [...(faulty ? [`${id}-faults`] : []), ...(hinted ? [`${id}-hint`] : [])];
  return { id, "aria-invalid": faulty, "aria-describedby": described.join(" ") || undefined };
}

export function Faults({ pointer, title }: { pointer: string; title: string }) {
  const found = faults.value.get(pointer);
  if (!found) return null;
  return (
    <div class="fault" id={`${controlId(pointer)}-faults`}>
      {found.map((fault) => (
        <p key={`${fault.pointer} ${fault.detail}`}>{sentence(fault, pointer, title, titles.value)}</p>
      ))}
    </div>
  );
}

/** A labelled control with a hint and the faults of its pointer. */
export function Field(props: { pointer: string; title: string; hint?: string; children: ComponentChildren }) {
  const id = controlId(props.pointer);
  return (
    <div class="field">
      <label for={id}>{props.title}</label>
      {props.children}
      <Faults pointer={props.pointer} title={props.title} />
      {props.hint !== undefined && <div class="hint" id={`${id}-hint`}>{props.hint}</div>}
    </div>
  );
}

/** Unfolds the parts around a control and focuses the control. */
export function goTo(pointer: string): void {
  const control = document.getElementById(controlId(pointer));
  for (let at = control?.parentElement; at; at = at.parentElement) {
    if (at instanceof HTMLDetailsElement) at.open = true;
  }
  control?.scrollIntoView({ block: "center" });
  control?.focus({ preventScroll: true });
}
