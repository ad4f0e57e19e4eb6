// The form's request and its programs, without a browser.
import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { test } from "node:test";
import type { BatchValidation, Preset, Validation, WorkerList } from "oviduct-client";
import { placeInQueue, standstill } from "../src/growing/words.ts";
import { costOf } from "../src/request/cost.ts";
import { assign, sentence } from "../src/request/faults.ts";
import { BLANK, requestOf, variedFrom, variedOf, type Form, type Request } from "../src/request/form.ts";
import { groupsOf, parametersOf, type SchemaNode } from "../src/request/parameters.ts";
import { changesOf } from "../src/request/patch.ts";
import { addKey, extent, moveKey, removeKey, round, stepOf, valueAt, type Schedule } from "../src/request/schedule.ts";
import { snippets } from "../src/request/snippets.ts";
import { readList, readNumber, readPoints, readSeeds } from "../src/request/text.ts";

// Excerpts of `GET /schema` and `GET /presets/pig`.
const schema: SchemaNode = {
  properties: {
    steps: { type: "integer", minimum: 1, maximum: 100_000 },
    friction: scheduled(0, 2.5, 1.25, "the integration is unstable above it"),
    collision: { title: "Self-intersection force", properties: { gap_um: scheduled(5, 1000, 497.5) } },
    solver: { title: "Solver", properties: { integrator: { type: "string", enum: ["rk4", "euler"], "x-enum-descriptions": ["A.", "B."] } } },
    mesh: { title: "Surface", properties: { strips: { type: "boolean" } } },
    course: { title: "Course", properties: { points_mm: { type: "array", items: { type: "array", items: { type: "number" }, minItems: 3 } } } },
    outline: {
      title: "Outline",
      properties: {
        points: { type: "array", items: { type: "array", items: { type: "number" }, minItems: 2 } },
        grid: { type: "array", items: { type: "array", items: { type: "number" } } },
      },
    },
  },
  $defs: {
    Fluctuation: { properties: { amplitude: { type: "number", minimum: 0 }, period: { minimum: 2, maximum: 1e6 } } },
    Schedule: {
      properties: {
        ease: { enum: ["linear", "smooth"], "x-enum-descriptions": ["Straight line.", "Smoothstep."] },
        fluctuation: { $ref: "#/$defs/Fluctuation" },
        keys: { maxItems: 256 },
      },
    },
  },
};

function scheduled(minimum: number, maximum: number, amplitude: number, reason?: string): SchemaNode {
  const constant: SchemaNode = { type: "number", minimum, maximum, ...(reason ? { "x-maximum-reason": reason } : {}) };
  const along: SchemaNode = { $ref: "#/$defs/Schedule", properties: { fluctuation: { properties: { amplitude: { maximum: amplitude } } } } };
  return { oneOf: [constant, along] };
}

const GAP: Schedule = { keys: [[0, 60], [0.125, 60], [0.45, 36], [1, 36]], ease: "smooth" };
const preset = {
  name: "pig",
  parameters: [
    ["/steps", 2000],
    ["/friction", 0.3],
    ["/collision/gap_um", GAP],
    ["/solver/integrator", "rk4"],
    ["/mesh/strips", false],
    ["/course/points_mm", []],
    ["/outline/points", []],
    ["/outline/grid", []],
  ].map(([pointer, value]) => ({ pointer, value, title: pointer, description: "", unit: "", source: null })),
} as unknown as Preset;
const parameters = parametersOf(schema, preset);

function bodyOf(form: Partial<Form>): Record<string, unknown> {
  const request = requestOf({ ...BLANK, ...form }, "pig", parameters);
  assert(!Array.isArray(request), JSON.stringify(request));
  return request.body;
}

test("parameters have the kinds and bounds of the schema", () => {
  const [steps, friction, gap, integrator, strips, points] = parameters.map(({ kind }) => kind);
  assert.deepEqual(steps, { type: "number", integer: true, bounds: { minimum: 1, maximum: 100_000, reason: undefined } });
  assert(friction?.type === "schedule" && gap?.type === "schedule");
  assert.deepEqual(friction.bounds, { minimum: 0, maximum: 2.5, reason: "the integration is unstable above it" });
  assert.deepEqual([friction.amplitude.minimum, friction.amplitude.maximum, friction.period.maximum], [0, 1.25, 1e6]);
  assert.deepEqual([friction.mostKeys, friction.eases.map(({ name }) => name)], [256, ["linear", "smooth"]]);
  assert.deepEqual(integrator, { type: "choice", choices: [{ name: "rk4", description: "A." }, { name: "euler", description: "B." }] });
  assert.deepEqual([strips, points], [{ type: "flag" }, { type: "points", coordinates: 3 }]);
  const groups = groupsOf(schema, parameters).map(({ title, parameters }) => [title, parameters.length]);
  assert.deepEqual(groups, [["General", 2], ["Self-intersection force", 1], ["Solver", 1], ["Surface", 1], ["Course", 1], ["Outline", 2]]);
});

test("a request holds only what differs from the preset and the defaults", () => {
  assert.deepEqual(bodyOf({}), { preset: "pig" });
  assert.deepEqual(bodyOf({ changes: { "/steps": 2000, "/collision/gap_um": GAP } }), { preset: "pig" });
  assert.deepEqual(bodyOf({ seed: " 7 ", backend: "cpu", priority: "3", reuse: false, outputs: ["obj"], labels: [{ name: "a", value: "" }, { name: "", value: "" }] }), {
    preset: "pig", seed: 7, backend: "cpu", priority: 3, reuse: false, outputs: ["obj"], labels: { a: "" },
  });
  const keys: Schedule["keys"] = [[0, 60], [1, 30]];
  const spec = (changes: Form["changes"]) => bodyOf({ changes })["spec"];
  assert.deepEqual(spec({ "/collision/gap_um": 40, "/mesh/strips": true }), { collision: { gap_um: 40 }, mesh: { strips: true } });
  assert.deepEqual(spec({ "/collision/gap_um": { keys, ease: "smooth" } }), { collision: { gap_um: { keys } } });
  assert.deepEqual(spec({ "/collision/gap_um": { ...GAP, ease: "linear" } }), { collision: { gap_um: { ease: "linear" } } });
  assert.deepEqual(spec({ "/friction": { keys, ease: "linear", fluctuation: { amplitude: 0.1, period: 50 } } }), {
    friction: { keys, fluctuation: { amplitude: 0.1, period: 50 } },
  });
});

test("a fluctuation of the preset is switched off by its amplitude", () => {
  const waving = parameters.map((parameter) =>
    parameter.pointer === "/collision/gap_um" ? { ...parameter, preset: { ...GAP, fluctuation: { amplitude: 2, period: 90 } } } : parameter,
  );
  const request = requestOf({ ...BLANK, changes: { "/collision/gap_um": GAP } }, "pig", waving);
  assert.deepEqual(!Array.isArray(request) && request.body.spec, { collision: { gap_um: { fluctuation: { amplitude: 0 } } } });
});

test("the spec of a model gives the changes that made it", () => {
  const resolved = { steps: 2000, friction: 0.2, collision: { gap_um: { ...GAP, fluctuation: { amplitude: 0 } } }, solver: { integrator: "euler" }, mesh: { strips: false } };
  assert.deepEqual(changesOf(resolved, parameters), { "/friction": 0.2, "/solver/integrator": "euler" });
});

test("points are written one a line, or as JSON", () => {
  const points = [[0, 0, 0], [1.5, -2, 30]];
  for (const text of ["0, 0, 0\n1.5 -2 30\n", "[[0,0,0],[1.5, -2, 30]]", "[0, 0, 0],\n[1.5, -2, 30],"]) assert.deepEqual(readPoints(text, 3), points);
  assert.deepEqual(bodyOf({ changes: { "/course/points_mm": "0, 0, 0\n1.5, -2, 30" } })["spec"], { course: { points_mm: points } });
  assert.deepEqual(changesOf({ course: { points_mm: points } }, parameters), { "/course/points_mm": "0, 0, 0\n1.5, -2, 30" });
  const [fault] = requestOf({ ...BLANK, changes: { "/course/points_mm": "0, 0, 0\n1, 2" } }, "pig", parameters) as { pointer: string; detail: string }[];
  assert.deepEqual([fault!.pointer, fault!.detail], ["/spec/course/points_mm", "point 2, “1, 2”, is not three numbers such as 0, 0, 12"]);
  const outline = { "/outline/points": "1, 0\n0, 1\n-1, -1", "/outline/grid": "1, 1\n1, 1" };
  assert.deepEqual(bodyOf({ changes: outline })["spec"], { outline: { points: [[1, 0], [0, 1], [-1, -1]], grid: [[1, 1], [1, 1]] } });
  assert.equal(readPoints("1, 0, 0", 2), "point 1, “1, 0, 0”, is not two numbers such as 0.5, -1");
  assert.equal(readPoints("1, 1\n1", 0), "row 2, “1”, is not 2 numbers: as many as there are rows");
});

test("what is no number is a fault at its field", () => {
  const pointers = (form: Partial<Form>) => {
    const request = requestOf({ ...BLANK, ...form }, "pig", parameters);
    return Array.isArray(request) ? request.map(({ pointer }) => pointer) : [];
  };
  assert.deepEqual(pointers({ seed: "x", priority: "", changes: { "/steps": NaN } }), ["/spec/steps", "/priority", "/seed"]);
  assert.deepEqual(pointers({ changes: { "/collision/gap_um": { ...GAP, keys: [[0, 1], [1, NaN]] } } }), ["/spec/collision/gap_um/keys/1/1"]);
  assert.deepEqual(pointers({ purpose: "study", seeds: "given", seedList: "9..1" }), ["/seeds"]);
  assert.deepEqual(pointers({ labels: [{ name: "a/b", value: "1" }, { name: "a/b", value: "2" }] }), ["/labels/a~1b"]);
  const varied = { pointer: "/collision/gap_um", values: "range", from: "1", to: "", count: "x", list: "" } as const;
  const list = { ...varied, values: "list", list: "28,5; 30,5" } as const;
  assert.deepEqual(pointers({ purpose: "study", varied: [list] }), ["/vary/values/~1collision~1gap_um"]);
  assert.deepEqual(pointers({ purpose: "study", varied: [varied] }), ["/vary/values/~1collision~1gap_um/to", "/vary/values/~1collision~1gap_um/count"]);
});

test("studies have seeds and a design", () => {
  const study = (form: Partial<Form>) => bodyOf({ purpose: "study", seed: "9", ...form });
  assert.deepEqual(study({}), { preset: "pig", count: 5 });
  assert.deepEqual(study({ seeds: "given", seedList: "1..3, 42" }), { preset: "pig", seeds: [1, 2, 3, 42] });
  assert.deepEqual(study({ seeds: "one" }), { preset: "pig", count: 1 });
  const varied = [variedFrom(parameters[1]!), variedFrom(parameters[3]!)];
  assert.deepEqual(study({ seeds: "one", varied })["vary"], {
    design: "grid", values: { "/friction": { from: 0.24, to: 0.36, count: 5 }, "/solver/integrator": ["rk4", "euler"] },
  });
  assert.deepEqual(study({ varied: varied.slice(0, 1), design: "lhs", samples: "7" })["vary"], {
    design: "lhs", samples: 7, values: { "/friction": { from: 0.24, to: 0.36 } },
  });
});

test("a study varies what its preset has, and keeps the rest", () => {
  const foreign = { pointer: "/bending", values: "range", from: "x", to: "", count: "5", list: "" } as const;
  const varied = [foreign, variedFrom(parameters[1]!)];
  assert.deepEqual(variedOf({ ...BLANK, varied }, parameters), varied.slice(1));
  const body = bodyOf({ purpose: "study", varied });
  assert.deepEqual(body["vary"], { design: "grid", values: { "/friction": { from: 0.24, to: 0.36, count: 5 } } });
  assert.deepEqual(bodyOf({ purpose: "study", seeds: "one", varied: [foreign] }), { preset: "pig", count: 1 });
});

test("numbers, seeds and lists are read as typed", () => {
  assert.deepEqual(["1", " -2.5e-3 ", ".5", "5.", "", "1,5", "0x10", "1e999", "five"].map(readNumber), [1, -0.0025, 0.5, 5, NaN, NaN, NaN, NaN, NaN]);
  assert.deepEqual(readSeeds("1 .. 3, 42;7"), [1, 2, 3, 42, 7]);
  assert.match(String(readSeeds("1, x")), /“x”/);
  assert.match(String(readSeeds("1.5")), /“1.5”/);
  assert.deepEqual(readSeeds("9007199254740990..9007199254740991"), [2 ** 53 - 2, 2 ** 53 - 1]);
  assert.match(String(readSeeds("9007199254740990..9007199254740993")), /greatest seed/);
  assert.equal((readSeeds("1..9999, 7") as number[]).length, 10_000);
  for (const long of ["0..10000", "1..9999, 7, 8", "1..6000, 1..6000"]) assert.match(String(readSeeds(long)), /more than 10,000/);
  assert.deepEqual(readList("25, 30 true rk4"), [25, 30, true, "rk4"]);
  assert.deepEqual(readList("28.5; 30.5"), [28.5, 30.5]);
  assert.match(String(readList("28.5; 30,5")), /“30,5”.*point/);
});

test("curves pass through their keys, and keys stay in order and in bounds", () => {
  assert.deepEqual([0, 0.05, 0.125, 0.45, 0.9, 1].map((u) => valueAt(GAP, u)), [60, 60, 60, 36, 36, 36]);
  assert.equal(round(valueAt(GAP, (0.125 + 0.45) / 2), 1e-9), 48);
  assert.equal(round(valueAt(GAP, 0.125 + 0.325 / 4), 1e-9), 60 - 24 * 0.15625);
  assert.equal(valueAt({ keys: [[0, 1], [1, 5]], ease: "linear" }, 0.25), 2);
  const bounds = { minimum: 5, maximum: 1000 };
  assert.deepEqual(moveKey(GAP, 1, [0.7, 2], bounds).keys[1], [0.449, 5]);
  assert.deepEqual(moveKey(GAP, 0, [0.7, 2000], bounds).keys[0], [0, 1000]);
  assert.deepEqual(moveKey(GAP, 3, [0.7, 20], bounds).keys[3], [1, 20]);
  const added = addKey(GAP, 0.2875, 1);
  assert.deepEqual([added?.index, added?.schedule.keys[2]], [2, [0.288, 48]]);
  assert.equal(addKey(GAP, 1, 1), undefined);
  assert.equal(addKey(GAP, 0.125, 1), undefined);
  assert.equal(removeKey(GAP, 0), GAP);
  assert.deepEqual(removeKey(GAP, 1).keys, [[0, 60], [0.45, 36], [1, 36]]);
  assert.deepEqual(extent({ ...GAP, fluctuation: { amplitude: 4, period: 10 } }), [32, 64]);
  assert.deepEqual([0.75, 0.003, 80, 2, 0].map(stepOf), [0.5, 0.002, 50, 2, 0.01]);
  assert.equal(round(0.30000000000000004, 0.002), 0.3);
});

test("faults go to the nearest field and say which part they mean", () => {
  const faults = [
    { pointer: "/spec/collision/gap_um/keys/1/0", detail: "is 2, above the greatest allowed 1" },
    { pointer: "/spec/collision", detail: "is odd" },
    { pointer: "/vary/values/~1collision~1gap_um/2", detail: "is 0" },
    { parameter: "view", detail: "unknown" },
  ];
  const fields = ["/spec/collision/gap_um", "/spec/steps", "/vary/values/~1collision~1gap_um"];
  const titles = new Map([["/steps", "Time steps"]]);
  const assigned = assign(faults, fields);
  assert.deepEqual([...assigned], [["", [faults[1], faults[3]]], [fields[0], [faults[0]]], [fields[2], [faults[2]]]]);
  assert.equal(sentence(faults[0]!, fields[0]!, "Lumen gap", titles), "The place of key 2 is 2, above the greatest allowed 1.");
  assert.equal(sentence(faults[2]!, fields[2]!, "Lumen gap", titles), "Entry 3 is 0.");
  assert.equal(sentence(faults[3]!, "", "The request", titles), "Unknown.");
  const costly = { pointer: "/spec", detail: "the model would take about 9790900992 bytes; reduce /steps, or see https://a.example/steps" };
  assert.equal(
    sentence(costly, "", "The request", titles),
    "The model would take about 9,790,900,992 bytes; reduce “Time steps”, or see https://a.example/steps.",
  );
});

function workersOf(...states: [backend: string, state: string][]): WorkerList {
  return { pause: null, workers: states.map(([backend, state]) => ({ backend, state })) } as unknown as WorkerList;
}

test("costs are given for the backends that exist", () => {
  const seconds = { cpu: { seconds: 2.71 }, "cpu-single": { seconds: 4.9 }, gpu: { seconds: 65 } };
  const bytes = { glb: 38_323_216, obj: 1e9, sections: 7_188_931, report: 131_072 };
  const cost = { seconds, bytes, triangles: 1_596_630, sections: 201, particles_end: 8300, memory_bytes: 236_848_552 };
  const model = { kind: "model", validation: { cost } as unknown as Validation } as const;
  const headline = (...given: Parameters<typeof costOf>) => costOf(...given)?.headline;
  const both = workersOf(["cpu", "active"], ["gpu", "active"]);
  assert.equal(headline(model, "auto", both), "about 1 min 5 s on the GPU");
  assert.deepEqual(costOf(model, "auto", both)?.details, [
    ["Or", "about 2.7 s on the CPU"], ["Surface", "1.6 million triangles"], ["Sections", "201"], ["Particles at the end", "8,300"],
    ["Model", "38.3 MB as glb, 1 GB as obj"], ["All files", "1.05 GB"], ["Memory to grow it", "237 MB"],
  ]);
  assert.equal(headline(model, "auto", workersOf(["cpu", "active"], ["gpu", "paused"])), "about 2.7 s on the CPU");
  assert.equal(headline(model, "cpu-single", both), "about 4.9 s on one core");
  assert.equal(headline(model, "auto", undefined), "about 2.7 s on the CPU");
  const points = [{ cost }, { cost: { ...cost, triangles: 4000 } }];
  const sum = { seconds: { cpu: 11 }, bytes: 9e9, memory_bytes: 2e8 };
  const study = { kind: "study", validation: { cost: sum, models: 6, points, seeds: null } as unknown as BatchValidation } as const;
  assert.equal(headline(study, "auto", workersOf(["cpu", "active"])), "6 models: about 11 s on the CPU in all");
  assert.deepEqual(costOf(study, "cpu", undefined)?.details.slice(0, 2), [
    ["Models", "2 points × 3 seeds, drawn"], ["Surface of each", "4,000 to 1.6 million triangles"],
  ]);
});

test("who would start the request is said if nobody would", () => {
  const title = (...given: Parameters<typeof standstill>) => standstill(...given)?.title;
  assert.equal(title(workersOf(["cpu", "active"]), "auto"), undefined);
  assert.equal(title(workersOf(["cpu", "active"]), "cpu-single"), undefined);
  assert.equal(title(undefined, "auto"), undefined);
  assert.equal(title(workersOf(), "auto"), "No worker is running");
  assert.equal(title(workersOf(["cpu", "draining"]), "auto"), "No worker takes new models");
  assert.equal(title(workersOf(["cpu", "active"]), "gpu"), "No GPU worker is active");
  assert.equal(title(workersOf(["gpu", "active"]), "cpu"), "No CPU worker is active");
  const full = workersOf(["cpu", "active"]).workers.map((worker) => ({ ...worker, condition: "storage" as const }));
  assert.equal(title({ ...workersOf(), workers: full }, "auto"), "The workers cannot store files");
  const [gpu] = workersOf(["gpu", "active"]).workers;
  assert.equal(title({ ...workersOf(), workers: [...full, gpu!] }, "auto"), undefined);
  assert.equal(title({ ...workersOf(), workers: [...full, gpu!] }, "cpu"), "No CPU worker is active");
  assert.equal(title({ ...workersOf(["cpu", "active"]), pause: { since: "2026-01-01T00:00:00Z" } }, "auto"), "All workers are paused");
});

test("a queued model tells its place and the reason why it waits", () => {
  const place = (queue: Partial<Parameters<typeof placeInQueue>[0]>) =>
    placeInQueue({ position: 0, position_is_exact: true, reason: null, wait_seconds: null, ...queue });
  assert.equal(place({}), "Next in the queue");
  assert.equal(place({ position: 1 }), "1 model is ahead");
  assert.equal(place({ position: 1000, position_is_exact: false }), "At least 1000 models are ahead");
  assert.equal(place({ position: 2, reason: "storage" }), "2 models are ahead; the workers cannot store files");
  assert.equal(place({ position: 0, reason: "no-worker" }), "Next in the queue; no running worker can grow it");
});

// Text that breaks naive quoting in one of the languages.
const labels = Object.fromEntries([
  ["it's", `"double" 'single' \\ \`back\` $HOME $(id) \${x} !x`],
  ["__proto__", "line\nbreak\ttab\u2028 end"],
  ["π 🐖", "\ud800 \u007f"],
]);
const requests: Request[] = [
  { purpose: "model", body: { preset: "pig", seed: 7, labels, outputs: ["obj"], reuse: false, spec: { steps: 120, friction: 1e-7, mesh: { strips: true }, collision: { gap_um: { keys: GAP.keys as [number, number][], ease: "linear" } } } } },
  { purpose: "model", body: { preset: "pig" } },
  { purpose: "study", body: { preset: "pig", count: 3, labels } },
  { purpose: "study", body: { preset: "pig", seeds: [1, 2], vary: { design: "grid", values: { "/friction": { from: 0.1, to: 0.4, count: 4 }, "/mesh/strips": [false, true] } } } },
];
const SERVICE = "https://lab.example/o'viduct/";
const CALLS = ["submit", "submit", "submit_batch", "study"];

for (const [i, request] of requests.entries()) {
  const code = Object.fromEntries(snippets(request, SERVICE, true).map(({ name, code }) => [name, code]));
  const path = request.purpose === "model" ? "models" : "batches";

  test(`request ${i} as JSON and curl`, () => {
    assert.deepEqual(JSON.parse(code["JSON"]!), request.body);
    const shim = `curl() { node -e 'console.log(JSON.stringify(process.argv.slice(1)))' -- "$@"; }\nOVIDUCT_KEY=secret\n`;
    const output = JSON.parse(execFileSync("bash", ["-c", shim + code["curl"]], { encoding: "utf8" })) as string[];
    assert.deepEqual(output.slice(0, -1), [SERVICE + path, "-H", "Authorization: Bearer secret", "-H", "Content-Type: application/json", "-d"]);
    assert.deepEqual(JSON.parse(output.at(-1)!), request.body);
  });

  test(`request ${i} as Python`, () => {
    const stub = `
import json, sys, types
class Client:
    def __init__(self, url): self.calls = [url]; Client.last = self
    def __getattr__(self, name): return lambda *given, **members: self.calls.append([name, members])
sys.modules["oviduct"] = types.SimpleNamespace(Client=Client)
exec(compile(sys.stdin.read(), "snippet", "exec"))
print(json.dumps(Client.last.calls))`;
    const output = execFileSync("python3", ["-c", stub], { encoding: "utf8", input: code["Python"], env: { ...process.env, PYTHONUTF8: "1" } });
    const [url, [call, members]] = JSON.parse(output) as [string, [string, unknown]];
    assert.deepEqual([url, call, members], [SERVICE, CALLS[i], request.body]);
  });

  test(`request ${i} as TypeScript`, async () => {
    const stub = `
const calls = [];
class Oviduct {
  constructor(...given) {
    calls.push(given);
    return new Proxy({}, { get: (_, name) => async (...given) => (calls.push([name, ...given]), { id: "x" }) });
  }
}`;
    process.env["OVIDUCT_KEY"] = "secret";
    const script = code["TypeScript"]!.replace('import { Oviduct } from "oviduct-client";', stub);
    const { default: calls } = (await import(`data:text/javascript,${encodeURIComponent(`${script.toWellFormed()}\nexport default calls;`)}`)) as { default: unknown[] };
    const method = request.purpose === "model" ? "submit" : "submitBatch";
    assert.deepEqual(calls.slice(0, 2), [[SERVICE, { key: "secret" }], [method, request.body]]);
  });
}

test("without a key, none is mentioned in requests", () => {
  for (const { name, code } of snippets(requests[1]!, SERVICE, false)) {
    if (name !== "Python") assert(!code.includes("OVIDUCT_KEY"), name);
  }
});
