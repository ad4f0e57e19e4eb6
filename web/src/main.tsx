import { render } from "preact";
import { App } from "./app.tsx";
import { watch } from "./stream.ts";
import "./ui/theme.css";

render(<App />, document.getElementById("app")!);
watch();
