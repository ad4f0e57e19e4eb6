// Real pages in Debian's Chromium with software WebGL, observed for errors.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { chromium, type Browser, type BrowserContextOptions, type Locator, type Page } from "playwright-core";
import { PNG } from "pngjs";

const EXECUTABLE = process.env["CHROMIUM"] ?? "/usr/bin/chromium";
const FLAGS = [
  "--no-sandbox",
  "--headless",
  "--disable-gpu-sandbox",
  "--use-gl=angle",
  "--use-angle=swiftshader",
  "--enable-unsafe-swiftshader",
  "--disable-background-networking",
  // A foreign host name, whose pages are not a secure context.
  "--host-resolver-rules=MAP lab.example 127.0.0.1",
];
const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

let browser: Browser | undefined;

export async function closeBrowser(): Promise<void> {
  await browser?.close();
  browser = undefined;
}

/** A page, and the errors in it. */
export class Visit {
  readonly page: Page;
  readonly #faults: string[] = [];
  /** True while the service is down, so failed requests are not errors. */
  away = false;
  /** Statuses of refusals that the test provokes, because browsers log them. */
  refusals: number[];

  private constructor(page: Page, origin: string, refusals: number[]) {
    this.page = page;
    this.refusals = refusals;
    page.on("pageerror", (error) => this.#faults.push(`exception: ${error.stack ?? error.message}`));
    page.on("console", (message) => {
      const text = message.text();
      const refused = Number(/Failed to load resource: .*status of (\d+)/.exec(text)?.[1]);
      const provoked = this.refusals.includes(refused) || (this.away && /Failed to load resource|ERR_/.test(text));
      if (["error", "warning"].includes(message.type()) && !provoked && !isNoise(text)) {
        this.#faults.push(`console: ${text} (${message.location().url})`);
      }
    });
    page.on("request", (request) => {
      const url = request.url();
      if (!/^(blob|data):/.test(url) && !url.startsWith(origin)) this.#faults.push(`elsewhere: ${url}`);
    });
  }

  static async open(url: string, options: BrowserContextOptions = {}, refusals: number[] = []): Promise<Visit> {
    const launch = (): Promise<Browser> => chromium.launch({ executablePath: EXECUTABLE, args: FLAGS });
    // Chromium 156 sometimes crashes at start, before it has a page.
    browser ??= await launch().catch(launch);
    const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, reducedMotion: "reduce", ...options });
    await context.addInitScript(() => {
      addEventListener("securitypolicyviolation", (event) => {
        console.error(`policy: ${event.violatedDirective} refused ${event.blockedURI}`);
      });
    });
    const page = await context.newPage();
    page.setDefaultTimeout(60_000);
    const visit = new Visit(page, new URL(url).origin, refusals);
    await page.goto(url);
    return visit;
  }

  /** Fails if there was an error; closes the page. */
  async close(): Promise<void> {
    assert.deepEqual(this.#faults, []);
    await this.page.context().close();
  }

  /** Fails if axe-core finds a serious fault in the shown page. */
  async accessible(): Promise<void> {
    // The debugger evaluates the script, because the policy of the page does not apply to it.
    if (!(await this.page.evaluate("'axe' in window"))) await this.page.evaluate(AXE);
    const found = await this.page.evaluate(async () => {
      const axe = (window as unknown as { axe: typeof import("axe-core") }).axe;
      const { violations } = await axe.run(document, { resultTypes: ["violations"] });
      return violations.map(({ id, impact, nodes }) => ({ id, impact, nodes: nodes.map((node) => node.html.slice(0, 160)) }));
    });
    assert.deepEqual(found.filter(({ impact }) => impact === "serious" || impact === "critical"), []);
  }
}

/** Messages of the browser about software rendering. */
function isNoise(text: string): boolean {
  return /GPU stall due to ReadPixels|software WebGL|GroupMarkerNotSet/.test(text);
}

export const canvasOf = (page: Page): Locator => page.getByRole("application", { name: /^3D view/ });

/** Waits until the picture is drawn and no longer changes. */
export async function settled(page: Page): Promise<void> {
  await page.locator(".picture-flight[aria-busy=true]").first().waitFor({ state: "detached" });
  const frames = () => canvasOf(page).first().getAttribute("data-frames");
  for (let [last, same] = ["", 0]; same < 4; ) {
    await page.waitForTimeout(150);
    const now = (await frames()) ?? "";
    same = now === last && now !== "" ? same + 1 : 0;
    last = now;
  }
  await page.getByText(/^Loading/).first().waitFor({ state: "detached" });
}

/** The first 3D picture after it has settled. */
export async function shown(page: Page): Promise<PNG> {
  await settled(page);
  return picture(canvasOf(page).first());
}

export async function picture(element: Locator): Promise<PNG> {
  return PNG.sync.read(await element.screenshot());
}

/** Number of different colours; 1 for an empty picture. */
export function colours({ data }: PNG): number {
  const seen = new Set<number>();
  for (let i = 0; i < data.length; i += 4) seen.add((data[i]! << 16) | (data[i + 1]! << 8) | data[i + 2]!);
  return seen.size;
}

/** Fraction of the pixels that differ visibly. */
export function difference(a: PNG, b: PNG): number {
  assert.deepEqual([a.width, a.height], [b.width, b.height]);
  let differ = 0;
  for (let i = 0; i < a.data.length; i += 4) {
    const most = Math.max(...[0, 1, 2].map((k) => Math.abs(a.data[i + k]! - b.data[i + k]!)));
    if (most > 24) differ++;
  }
  return differ / (a.width * a.height);
}
