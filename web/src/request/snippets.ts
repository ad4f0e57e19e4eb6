// The request of the form as programs that send it.
import type { Request } from "./form.ts";

export interface Snippet {
  name: "curl" | "Python" | "TypeScript" | "JSON";
  code: string;
}

/** Maximum width of a line with an array or object. */
const WIDTH = 88;

/**
 * @param service URL of the service, with a final slash.
 * @param keyed True if the service requires an API key. The programs read it from the variable
 *   OVIDUCT_KEY.
 */
export function snippets(request: Request, service: string, keyed: boolean): Snippet[] {
  return [
    { name: "curl", code: curl(request, service, keyed) },
    { name: "Python", code: python(request, service) },
    { name: "TypeScript", code: typescript(request, service, keyed) },
    { name: "JSON", code: layOut(request.body, JSON_STYLE) },
  ];
}

function curl({ purpose, body }: Request, service: string, keyed: boolean): string {
  const path = purpose === "model" ? "models" : "batches";
  return [
    `curl ${shell(service + path)}`,
    ...(keyed ? ['-H "Authorization: Bearer $OVIDUCT_KEY"'] : []),
    "-H 'Content-Type: application/json'",
    `-d ${shell(layOut(body, JSON_STYLE))}`,
  ].join(" \\\n  ");
}

function shell(text: string): string {
  return `'${text.replaceAll("'", "'\\''")}'`;
}

function python({ purpose, body }: Request, service: string): string {
  const call = purpose === "model" ? "submit" : "vary" in body ? "study" : "submit_batch";
  const members = Object.entries(body).map(([name, value]) => `    ${name}=${layOut(value, PYTHON_STYLE, 1)},\n`);
  const result = purpose === "model" ? "model" : "batch";
  const rest =
    purpose === "model"
      ? ["model = client.wait(model, progress=True)", 'client.download(model, "model.glb")']
      : ["batch = client.wait_batch(batch, progress=True)", "table = client.table(batch)"];
  return [
    "from oviduct import Client",
    "",
    `client = Client(${JSON.stringify(service)})  # with the key in OVIDUCT_KEY, if it is set`,
    `${result} = client.${call}(\n${members.join("")})`,
    ...withoutFile(rest, body),
  ].join("\n");
}

function typescript({ purpose, body }: Request, service: string, keyed: boolean): string {
  const options = keyed ? ', { key: process.env["OVIDUCT_KEY"] }' : "";
  const call = purpose === "model" ? "submit" : "submitBatch";
  const rest =
    purpose === "model"
      ? ["const model = await oviduct.wait(id);", 'const glb = await oviduct.bytes(model.id, "model.glb");']
      : ["const batch = await oviduct.waitBatch(id);", "const { columns, rows } = await oviduct.table(batch.id);"];
  return [
    'import { Oviduct } from "oviduct-client";',
    "",
    `const oviduct = new Oviduct(${JSON.stringify(service)}${options});`,
    `const { id } = await oviduct.${call}(${layOut(body, SCRIPT_STYLE)});`,
    ...withoutFile(rest, body),
  ].join("\n");
}

/** Removes the download of a file that the request does not ask for. */
function withoutFile(lines: string[], body: Request["body"]): string[] {
  return body.outputs && !body.outputs.includes("glb") ? lines.filter((line) => !line.includes("model.glb")) : lines;
}

interface Style {
  /** A member name, before the colon. */
  name: (name: string) => string;
  scalar: (value: unknown) => string;
  /** Text between the braces of a one-line object and its content. */
  padding: string;
  /** Text after the last member of a broken array or object. */
  trailing: string;
  indent: string;
}

// Strings and numbers of JSON are also valid in Python and JavaScript.
const JSON_STYLE: Style = { name: JSON.stringify, scalar: JSON.stringify, padding: " ", trailing: "", indent: "  " };
const PYTHON_STYLE: Style = {
  name: JSON.stringify,
  scalar: (value) => (value === true ? "True" : value === false ? "False" : value === null ? "None" : JSON.stringify(value)),
  padding: "",
  trailing: ",",
  indent: "    ",
};
const SCRIPT_STYLE: Style = {
  // In an object literal, `__proto__` would set the prototype.
  name: (name) => (name === "__proto__" ? '["__proto__"]' : /^[A-Za-z_$][\w$]*$/.test(name) ? name : JSON.stringify(name)),
  scalar: JSON.stringify,
  padding: " ",
  trailing: ",",
  indent: "  ",
};

/** JSON in the syntax of a language, on one line if it fits. */
function layOut(value: unknown, style: Style, depth = 0): string {
  const line = oneLine(value, style);
  const { indent } = style;
  if (typeof value !== "object" || value === null || indent.length * depth + line.length <= WIDTH) return line;
  const inner = (member: unknown) => layOut(member, style, depth + 1);
  const lines = Array.isArray(value)
    ? value.map(inner)
    : Object.entries(value).map(([name, member]) => `${style.name(name)}: ${inner(member)}`);
  const [open, close] = Array.isArray(value) ? "[]" : "{}";
  const body = lines.map((text) => indent.repeat(depth + 1) + text).join(",\n");
  return `${open}\n${body}${style.trailing}\n${indent.repeat(depth)}${close}`;
}

function oneLine(value: unknown, style: Style): string {
  if (typeof value !== "object" || value === null) return style.scalar(value);
  if (Array.isArray(value)) return `[${value.map((item) => oneLine(item, style)).join(", ")}]`;
  const members = Object.entries(value).map(([name, member]) => `${style.name(name)}: ${oneLine(member, style)}`);
  return members.length === 0 ? "{}" : `{${style.padding}${members.join(", ")}${style.padding}}`;
}
