// Lists members of generated types that are `unknown`, `any` or an object without members.
//
// Usage: node unknown.mjs TYPESCRIPT_MODULE TYPES.ts
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const { default: ts } = await import(pathToFileURL(process.argv[2]));
const source = ts.createSourceFile("types.ts", readFileSync(process.argv[3], "utf8"), ts.ScriptTarget.Latest, true);
const found = [];

/** What a type should not be, if it is that. */
function vague(node) {
  if (node.kind === ts.SyntaxKind.UnknownKeyword || node.kind === ts.SyntaxKind.AnyKeyword) return node.getText();
  const empty = ts.isTypeReferenceNode(node) && node.getText() === "Record<string, never>";
  return empty ? node.getText() : undefined;
}

function visit(node, place) {
  // Responses may have additional headers, so this index signature is not a member of the
  // description.
  if (ts.isIndexSignatureDeclaration(node) && place.at(-1) === "headers") return;
  const name = node.name && (ts.isPropertySignature(node) || ts.isInterfaceDeclaration(node)) ? node.name.text : undefined;
  const here = name === undefined ? place : [...place, name];
  if (vague(node)) found.push(`${here.join(" / ")}: ${vague(node)}`);
  ts.forEachChild(node, (child) => visit(child, here));
}

for (const statement of source.statements) {
  // The names inside these interfaces are used elsewhere. `webhooks` and `$defs` are empty and
  // therefore skipped.
  const name = statement.name?.text;
  if (ts.isInterfaceDeclaration(statement) && ["paths", "components", "operations"].includes(name)) visit(statement, []);
}
found.forEach((line) => console.log(line));
process.exit(found.length > 0 ? 1 : 0);
