// The frame of all pages: navigation, state of the connection, theme and API key.
import { computed } from "@preact/signals";
import type { FunctionComponent } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { OviductError } from "oviduct-client";
import { askingForKey, KeyDialog } from "./access.tsx";
import { connection, fault } from "./stream.ts";
import { href, route, setTitle } from "./router.ts";
import { explain, key, locked, session } from "./service.ts";
import { nextTheme, theme } from "./ui/theme.ts";
import { Icon, Notice, Toasts, Unloaded } from "./ui/widgets.tsx";
import { Models } from "./list/page.tsx";

type Page = FunctionComponent<Record<string, never>>;
type Loader = () => Promise<{ default: Page }>;

interface Place {
  title: string;
  /** Highlighted entry of the navigation. */
  section: "models" | "new" | "batches" | undefined;
  /** True if the page uses the whole width of the window. */
  wide?: boolean;
  load: Loader;
}

const models: Place = { title: "Models", section: "models", load: async () => ({ default: Models }) };
const PLACES = new Map<string, (path: string[]) => Place | undefined>([
  ["", () => models],
  ["new", () => ({ title: "New model", section: "new", load: () => import("./request/page.tsx") })],
  ["models", ([, id, ...more]) =>
    id !== undefined && more.length === 0
      ? { title: "Model", section: "models", wide: true, load: () => import("./model/page.tsx") }
      : undefined],
  ["compare", ([, a, b]) =>
    a !== undefined && b !== undefined
      ? { title: "Compare", section: "models", wide: true, load: () => import("./explore/compare.tsx") }
      : undefined],
  ["batches", ([, id]) => ({
    title: id === undefined ? "Studies" : "Study",
    section: "batches",
    load: () => import("./batches/page.tsx"),
  })],
]);

const missing: Place = {
  title: "Not found",
  section: undefined,
  load: async () => ({
    default: () => (
      <Notice title="There is no such page">
        <p>
          <a href={href([])}>Go to the models</a>
        </p>
      </Notice>
    ),
  }),
};

const place = computed(() => PLACES.get(route.value.path[0] ?? "")?.(route.value.path) ?? missing);
/** The path, which identifies the page. The query does not, so a changed query keeps the page. */
const address = computed(() => route.value.path.join("/"));

export function App() {
  const main = useRef<HTMLElement>(null);
  const { title, section, wide } = place.value;
  const first = useRef(true);
  // Links contain no API key.
  const open = key.value === undefined && locked.value === undefined;
  useEffect(() => {
    setTitle(title);
    // Keyboards and screen readers start at the new page.
    if (!first.current) main.current?.focus({ preventScroll: true });
    first.current = false;
    scrollTo(0, 0);
  }, [address.value]);
  return (
    <div class="shell">
      <a class="skip button" href="#main" onClick={(event) => (event.preventDefault(), main.current?.focus())}>
        Skip to content
      </a>
      <header>
        <a class="brand" href={href([])}>
          <img src="./icon.svg" alt="" /> oviduct
        </a>
        <nav aria-label="Pages">
          {entry("models", "Models", href([]), section)}
          {entry("batches", "Studies", href(["batches"]), section)}
          {entry("new", "New model", href(["new"], { purpose: "model" }), section)}
        </nav>
        <div class="tools">
          <ConnectionDot />
          <ThemeButton />
          <button type="button" class="button-icon" aria-label={key.value ? "Change or forget the key" : "Enter a key"} aria-pressed={key.value !== undefined} onClick={() => (askingForKey.value = true)}>
            <Icon name="key" />
          </button>
        </div>
      </header>
      <Banner />
      <main ref={main} id="main" tabIndex={-1} class={wide ? "wide" : undefined}>
        {locked.value === undefined ? <Shown key={`${session.value} ${address.value}`} place={place.value} /> : <Locked />}
      </main>
      <footer>
        <ul>
          <li><a href="docs">HTTP interface</a></li>
          {open && <li><a href="openapi.yaml">OpenAPI</a></li>}
          {open && <li><a href="presets">Presets</a></li>}
          <li>Method: Burkitt, Romano, Walker, Fazeli (2010)</li>
        </ul>
      </footer>
      {askingForKey.value && <KeyDialog />}
      <Toasts />
    </div>
  );
}

/** Shows why no changes arrive, and the time of the next attempt. */
function Banner() {
  if (locked.value !== undefined || (connection.value !== "lost" && connection.value !== "refused")) return null;
  const until = connection.value === "refused" ? "until you use another key" : "until the service can be reached again";
  return (
    <div class="banner" role="status">
      {fault.value instanceof OviductError ? explain(fault.value) : "The service does not answer."} What you see is what was known
      last; it is not updated {until}.
    </div>
  );
}

function entry(name: Place["section"], label: string, target: string, section: Place["section"]) {
  return (
    <a href={target} aria-current={section === name ? "page" : undefined}>
      {label}
    </a>
  );
}

/** A page, loaded when it is first shown. */
function Shown({ place }: { place: Place }) {
  const [page, setPage] = useState<{ Page: Page } | "unavailable">();
  useEffect(() => {
    place.load().then(({ default: Page }) => setPage({ Page }), () => setPage("unavailable"));
  }, []);
  if (page === "unavailable") return <Unloaded title="This page could not be loaded" />;
  return page ? <page.Page /> : <p class="soft" aria-busy="true">Loading …</p>;
}

function Locked() {
  return (
    <Notice title="This service asks for a key">
      <p>Whoever runs it gives out keys. Yours is kept in this tab only.</p>
      <p class="row">
        <button type="button" class="button button-primary" onClick={() => (askingForKey.value = true)}>Enter a key</button>
      </p>
    </Notice>
  );
}

function ConnectionDot() {
  const text = { connecting: "Connecting", live: "Connected: changes appear at once", lost: "Not connected", refused: "Not connected: the key may not read" }[connection.value];
  return <span class={`dot dot-${connection.value}`} role="img" aria-label={text} title={text} />;
}

function ThemeButton() {
  const label = { auto: "Theme: as the system", light: "Theme: light", dark: "Theme: dark" }[theme.value];
  return (
    <button type="button" class="button-icon" aria-label={label} title={label} onClick={nextTheme}>
      <Icon name={theme.value === "auto" ? "auto" : theme.value === "dark" ? "moon" : "sun"} />
    </button>
  );
}
