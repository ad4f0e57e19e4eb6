// graphile-worker as a peer of `bench queue`: prints its rates as one JSON object.
// Arguments: URL of an empty PostgreSQL database, seconds of each measurement.
import { Logger, makeWorkerUtils, run } from "graphile-worker";
import pg from "pg";

const [url, seconds] = [process.argv[2], Number(process.argv[3])];
const pool = new pg.Pool({ connectionString: url, max: 12 });
pool.on("error", () => {});
pool.on("connect", (client) => client.on("error", () => {}));
const utils = await makeWorkerUtils({ pgPool: pool });
await utils.migrate();

const submissions = {};
for (const callers of [1, 64]) {
  let count = 0;
  const begun = performance.now();
  const submit = async () => {
    while (performance.now() - begun < seconds * 1000) {
      await utils.addJob("grow", { preset: "pig", seed: count });
      count += 1;
    }
  };
  await Promise.all(Array.from({ length: callers }, submit));
  submissions[callers] = (count * 1000) / (performance.now() - begun);
}

let ended = 0;
const begun = performance.now();
const runner = await run({
  pgPool: pool,
  concurrency: 8,
  noHandleSignals: true,
  logger: new Logger(() => () => {}),
  taskList: { grow: async () => void (ended += 1) },
});
await new Promise((resolve) => setTimeout(resolve, seconds * 1000));
const rate = (ended * 1000) / (performance.now() - begun);
await runner.stop();
console.log(JSON.stringify({ store: "graphile-worker", submissions_per_second: submissions, ends_per_second: rate }));
process.exit(0);
