// Must be first, because the style sheets of pages override it.
import "./ui/theme.css";
import { render } from "preact";
import { App } from "./app.tsx";
import { keepOutlines } from "./growing/outlines.ts";
import { watch } from "./stream.ts";

render(<App />, document.getElementById("app")!);
keepOutlines();
watch();
