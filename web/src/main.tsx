// First, for the style sheets of pages change what it says.
import "./ui/theme.css";
import { render } from "preact";
import { App } from "./app.tsx";
import { keepOutlines } from "./growing/outlines.ts";
import { watch } from "./stream.ts";

render(<App />, document.getElementById("app")!);
keepOutlines();
watch();
