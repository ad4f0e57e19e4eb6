// Measures the frames per second of models in a browser that draws in software; see scripts/frames.
import { Oviduct } from "../../clients/typescript/src/index.ts";
import { Service } from "../../clients/typescript/test/service.ts";
import { closeBrowser, Visit } from "../test/page/browser.ts";

const SIZES = [[1280, 800], [1920, 1080], [390, 844]] as const;
/** Queries of the measured views, in which the model is turned or flown through. */
const MODES = { whole: "", opened: "open=20", across: "cut=0.6", "both cuts": "open=20&cut=0.6", flight: "fly=0.3" };
/** Milliseconds until the movement is steady, and milliseconds of the measurement. */
const [WARMING, MEASURED] = [3000, 5000];

const [wanted] = process.argv.slice(2);
const service = await Service.start();
try {
  const client = new Oviduct(service.url);
  const { id } = await client.submit({ preset: "pig", seed: 7 });
  await client.wait(id);
  console.log("page       canvas     mode       drawn      frames/s  longest   CPU ms a frame: all, page, drawing");
  for (const [width, height] of SIZES) {
    for (const [mode, query] of Object.entries(MODES)) {
      if (wanted && !`${width}x${height} ${mode}`.includes(wanted)) continue;
      console.log(await measure(`${service.url}/#/models/${id}?${query}`, width, height, mode));
    }
  }
} finally {
  await closeBrowser();
  await service[Symbol.asyncDispose]();
}

async function measure(url: string, width: number, height: number, mode: string): Promise<string> {
  const visit = await Visit.open(url, { viewport: { width, height }, reducedMotion: "no-preference" });
  const { page } = visit;
  const canvas = page.getByRole("application", { name: /^3D view/ });
  await page.getByText(/triangles are shown/).waitFor();
  await page.getByText(/^Loading/).first().waitFor({ state: "detached" });
  await page.waitForTimeout(2000);
  if (mode === "flight") {
    await page.getByRole("button", { name: "Play" }).click();
  } else {
    await canvas.evaluate((canvas) => {
      const turn = () => {
        canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
        requestAnimationFrame(turn);
      };
      turn();
    });
  }
  await page.waitForTimeout(WARMING);
  const debug = await page.context().browser()!.newBrowserCDPSession();
  const seconds = async () => {
    const { processInfo } = await debug.send("SystemInfo.getProcessInfo");
    return (...types: string[]) => processInfo.reduce((sum, { type, cpuTime }) => sum + (types.length === 0 || types.includes(type) ? cpuTime : 0), 0);
  };
  const before = await seconds();
  const { frames, elapsed, longest, pixels, shown } = await canvas.evaluate(async (canvas, duration) => {
    const count = () => Number((canvas as HTMLElement).dataset["frames"]);
    const [first, begin] = [count(), performance.now()];
    let [last, longest, at] = [first, 0, begin];
    while (performance.now() - begin < duration) {
      await new Promise(requestAnimationFrame);
      if (count() === last) continue;
      longest = Math.max(longest, performance.now() - at);
      [last, at] = [count(), performance.now()];
    }
    const { width, height, clientWidth, clientHeight } = canvas as HTMLCanvasElement;
    return { frames: last - first, elapsed: at - begin, longest, pixels: `${width}×${height}`, shown: `${clientWidth}×${clientHeight}` };
  }, MEASURED);
  const after = await seconds();
  const cpu = (...types: string[]) => ((1000 * (after(...types) - before(...types))) / frames).toFixed(0);
  await visit.close();
  const columns = [`${width}×${height}`, shown, mode].map((text) => text.padEnd(11));
  const rate = ((1000 * frames) / elapsed).toFixed(1);
  return [...columns, pixels.padEnd(11), rate.padStart(8), `${longest.toFixed(0)} ms`.padStart(9), `   ${cpu()}, ${cpu("renderer")}, ${cpu("GPU")}`].join("");
}
