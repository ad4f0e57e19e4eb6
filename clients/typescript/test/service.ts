// A live service for the tests: a binary on a free loopback port with its own directory.
import assert from "node:assert/strict";
import { execFileSync, spawn, type ChildProcess } from "node:child_process";
import { mkdtempSync, openSync, readFileSync, rmSync } from "node:fs";
import { createServer as createHttp, request, type RequestListener } from "node:http";
import { createServer, type AddressInfo } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";
import type { FitRequest, ModelRequest } from "oviduct-client";

/** A model that takes about a second: few steps and particles, but all stages. */
export const SMALL = {
  spec: { steps: 120, particles: { total: { keys: [[0, 300], [1, 600]] } }, lean: { strength_um: 0 } },
} satisfies ModelRequest;

/**
 * A model that takes hours, so it is still growing at the end of a test; its first sections come
 * soon.
 */
export const ENDLESS = { spec: { steps: 100_000, solver: { search: "all_pairs", record_every: 100 } } } satisfies ModelRequest;

/** A small fit. */
export const FIT = {
  ...SMALL,
  targets: [{ region: "ampulla", quantity: "lumen_perimeter_mm", value: 100 }],
  vary: [{ parameter: "/friction", from: 0.2, to: 0.4 }, { parameter: "/collision/gap_um" }],
  evaluations: 60,
  seeds: 1,
  models: 1,
} satisfies FitRequest;

/** A fit that takes more than half an hour, so it ends only if a test cancels or deletes it. */
export const ENDLESS_FIT = {
  ...FIT,
  spec: { steps: 1000, particles: { total: { keys: [[0, 600], [1, 2000]] } }, solver: { search: "all_pairs" } },
  evaluations: 2000,
} satisfies FitRequest;

const binary = process.env["OVIDUCT_BINARY"];

export class Service {
  readonly data = mkdtempSync(join(tmpdir(), "oviduct-client-"));
  readonly url: string;
  readonly #port: number;
  readonly #options: string[];
  #process: ChildProcess | undefined;

  private constructor(port: number, options: string[]) {
    this.#port = port;
    this.#options = options;
    this.url = `http://127.0.0.1:${port}`;
  }

  static async start(...options: string[]): Promise<Service> {
    const service = new Service(await freePort(), options);
    await service.start();
    return service;
  }

  /** Starts the service, also again, and waits until it is ready. */
  async start(): Promise<void> {
    assert(binary, "OVIDUCT_BINARY names the program to test");
    const log = openSync(join(this.data, "server.log"), "a");
    const line = ["serve", "--addr", `127.0.0.1:${this.#port}`, "--data", this.data, "--gpu", "off"];
    // The short lease makes the next process resume the jobs of a killed one soon. ENDLESS exceeds
    // the default limit.
    line.push("--heartbeat", "500ms", "--lease", "2s", "--max-model-time", "30d", ...this.#options);
    this.#process = spawn(binary, line, { stdio: ["ignore", log, log] });
    for (const end = Date.now() + 120_000; Date.now() < end; await sleep(50)) {
      if (this.#process.exitCode !== null) break;
      const answer = await fetch(`${this.url}/readyz`).catch(() => undefined);
      await answer?.body?.cancel();
      if (answer?.ok) return;
    }
    throw new Error(`the service did not become ready:\n${this.log()}`);
  }

  log(): string {
    return readFileSync(join(this.data, "server.log"), "utf8");
  }

  /** Kills the service with SIGKILL. */
  async kill(): Promise<void> {
    const ended = new Promise((resolve) => this.#process?.once("exit", resolve));
    this.#process?.kill("SIGKILL");
    await ended;
  }

  /** Creates an API key; the service then requires one. */
  async key(...options: string[]): Promise<string> {
    const line = ["keys", "add", "--create", "--data", this.data, "--owner", "lab", ...options];
    if (!options.includes("--scopes")) line.push("--scopes", "read,submit");
    const key = execFileSync(binary!, line, { encoding: "utf8", stdio: ["ignore", "pipe", "pipe"] }).trim();
    await until("the service knows the key", async () => {
      const tries: Record<string, string>[] = [{}, { authorization: `Bearer ${key}` }];
      const answers = tries.map((headers) => fetch(`${this.url}/presets`, { headers }));
      return (await Promise.all(answers)).map((answer) => answer.status).join() === "401,200";
    });
    return key;
  }

  async [Symbol.asyncDispose](): Promise<void> {
    await this.kill();
    rmSync(this.data, { recursive: true, force: true });
  }
}

/** Runs a test with its own service. */
export async function withService(options: string[], test: (service: Service) => Promise<void>): Promise<void> {
  const service = await Service.start(...options);
  try {
    await test(service);
  } catch (error) {
    console.error(service.log().split("\n").slice(-30).join("\n"));
    throw error;
  } finally {
    await service[Symbol.asyncDispose]();
  }
}

/** Runs a test with its own server at the URL that the test receives. */
export async function withServer(listener: RequestListener, test: (url: string) => Promise<void>): Promise<void> {
  const server = createHttp(listener);
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  try {
    await test(`http://127.0.0.1:${(server.address() as AddressInfo).port}`);
  } finally {
    server.closeAllConnections();
    await new Promise((resolve) => server.close(resolve));
  }
}

/** A proxy that serves `target` under a prefix, which it strips. */
export function proxy(prefix: string, target: string): RequestListener {
  return (incoming, answer) => {
    const path = incoming.url ?? "/";
    if (!path.startsWith(`${prefix}/`)) return void answer.writeHead(404).end("not the prefix");
    const { method, headers } = incoming;
    const onward = request(target + path.slice(prefix.length), { method, headers }, (reply) => {
      answer.writeHead(reply.statusCode ?? 502, reply.headers);
      reply.pipe(answer);
    });
    onward.on("error", () => answer.writeHead(502).end());
    answer.on("close", () => onward.destroy());
    incoming.pipe(onward);
  };
}

export async function until(what: string, holds: () => Promise<boolean>): Promise<void> {
  for (const end = Date.now() + 20_000; Date.now() < end; await sleep(50)) {
    if (await holds()) return;
  }
  throw new Error(`in vain: ${what}`);
}

/** A port on which nobody listens, below the range of outgoing connections. */
export async function freePort(): Promise<number> {
  for (;;) {
    const port = 15_000 + Math.floor(Math.random() * 15_000);
    const probe = createServer();
    const free = await new Promise<boolean>((resolve) => {
      probe.once("error", () => resolve(false));
      probe.listen(port, "127.0.0.1", () => probe.close(() => resolve(true)));
    });
    if (free) return port;
  }
}
