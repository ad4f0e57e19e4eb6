// Assignment of faults to the fields of a request.
import type { Fault } from "oviduct-client";

/** Faults by the pointer of their field; faults without a field are under "". */
export type Assigned = ReadonlyMap<string, readonly Fault[]>;

/**
 * Assigns each fault to the field with the longest pointer that contains it, in the order of
 * fields.
 */
export function assign(faults: readonly Fault[], fields: readonly string[]): Assigned {
  const byLength = fields.toSorted((a, b) => b.length - a.length);
  const assigned = new Map<string, Fault[]>(["", ...fields].map((field) => [field, []]));
  for (const fault of faults) {
    const pointer = fault.pointer ?? "";
    const field = byLength.find((field) => pointer === field || pointer.startsWith(`${field}/`)) ?? "";
    assigned.get(field)!.push(fault);
  }
  return new Map([...assigned].filter(([, found]) => found.length > 0));
}

/**
 * A fault as a sentence about its field or about the faulty part of the field.
 *
 * @param titles Titles of parameters, which replace the pointers in the service's text.
 */
export function sentence(fault: Fault, field: string, title: string, titles: ReadonlyMap<string, string>): string {
  const subject = part((fault.pointer ?? "").slice(field.length)) ?? title;
  const detail = fault.detail
    .replace(POINTER, (pointer) => (titles.has(pointer) ? `“${titles.get(pointer)}”` : pointer))
    .replace(LONG_NUMBER, (digits) => Number(digits).toLocaleString("en"));
  const text = /^(is|has|must|cannot|gives)\b/.test(detail) ? `${subject} ${detail}` : capital(detail);
  return /[.!?]$/.test(text) ? text : `${text}.`;
}

const POINTER = /(?<!\w)(\/\w+)+/g;
const LONG_NUMBER = /(?<![\d.,])\d{5,15}(?![\d.])/g;

export function capital(text: string): string {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

const PARTS: Record<string, string> = {
  "/keys": "The list of keys",
  "/ease": "The ease",
  "/fluctuation/amplitude": "The amplitude",
  "/fluctuation/period": "The period",
};

function part(rest: string): string | undefined {
  const key = /^\/keys\/(\d+)(?:\/([01]))?$/.exec(rest);
  if (key) return `${key[2] === "0" ? "The place of key" : key[2] === "1" ? "The value of key" : "Key"} ${Number(key[1]) + 1}`;
  const item = /^\/(\d+)(?:\/\d+)?$/.exec(rest);
  return item ? `Entry ${Number(item[1]) + 1}` : PARTS[rest];
}
