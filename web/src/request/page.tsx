// The form that requests a model or a study.
import type { ComponentChildren } from "preact";
import { useEffect, useState } from "preact/hooks";
import { watchWorkers } from "../growing/workers.tsx";
import { connection } from "../stream.ts";
import { href, route, setQuery, setTitle } from "../router.ts";
import { explain } from "../service.ts";
import { Icon, Notice } from "../ui/widgets.tsx";
import { checkWhileTyping, faults } from "./check.ts";
import { CodePanel } from "./code.tsx";
import { Marked, Segments } from "./inputs.tsx";
import { MoreOptions, PresetChoice, SeedField } from "./options.tsx";
import { ParameterField } from "./parameter.tsx";
import { groupsOf, type Group, type Parameter } from "./parameters.ts";
import { catalogue, change, fillFrom, form, loadCatalogue, origin, parameters, startOver } from "./state.ts";
import { StudyFields } from "./study.tsx";
import { GeneralFaults, Summary } from "./summary.tsx";
import "./request.css";

/** The most influential parameters come first: size, folds, their spacing, and their stiffness. */
const FIRST = [
  "/length_mm",
  "/particles/total",
  "/collision/gap_um",
  "/collision/tissue_um",
  "/containment/wall_um",
  "/variation/amplitude",
  "/bending",
  "/friction",
  "/steps",
];

export default function Page() {
  const [failure, setFailure] = useState<string>();
  const load = () => {
    setFailure(undefined);
    loadCatalogue().catch((error: unknown) => setFailure(explain(error)));
  };
  useEffect(load, []);
  useEffect(() => {
    if (failure !== undefined && connection.value === "live") load();
  }, [connection.value]);
  const ready = catalogue.value !== undefined;
  const { query } = route.value;
  useEffect(() => {
    if (!ready) return;
    void fillFrom(query);
    // Keep later changes across a reload. If another link was opened before this effect ran, the
    // next effect handles its query.
    if (route.peek().query === query) setQuery({});
  }, [ready, query]);

  if (failure !== undefined && !ready) {
    return (
      <Notice title="The form could not be loaded" kind="error">
        <p>{failure}</p>
        <p>
          <button type="button" class="button" onClick={load}>Try again</button>
        </p>
      </Notice>
    );
  }
  return ready ? <Form /> : <p class="soft" aria-busy="true">Loading …</p>;
}

function Form() {
  useEffect(checkWhileTyping, []);
  useEffect(watchWorkers, []);
  const study = form.value.purpose === "study";
  const title = study ? "New study" : "New model";
  useEffect(() => setTitle(title), [title]);
  const first = FIRST.flatMap((pointer) => parameters.value.find((parameter) => parameter.pointer === pointer) ?? []);
  const others = parameters.value.filter((parameter) => !first.includes(parameter));
  return (
    <div class="request-page">
      <div class="page-head">
        <h1>{title}</h1>
        <Segments label="What to request" value={form.value.purpose} choices={[["model", "One model"], ["study", "Study"]]} onChange={(purpose) => change({ purpose })} />
        <div class="actions">
          <button type="button" class="button" onClick={startOver}>
            <Icon name="retry" /> Start over
          </button>
        </div>
      </div>
      <div class="request-columns">
        <div class="stack">
          <GeneralFaults />
          <Origin />
          <section class="card stack">
            <PresetChoice />
            {!study && <SeedField />}
          </section>
          {study && <StudyFields />}
          <section class="card stack" aria-labelledby="parameters-title">
            <h2 id="parameters-title">Parameters</h2>
            <Fields parameters={first} />
          </section>
          <section class="card" aria-labelledby="others-title">
            <h2 id="others-title">All other parameters</h2>
            {groupsOf(catalogue.value!.schema, others).map((group) => (
              <Folded key={group.name} title={group.title} pointers={group.parameters.map(({ pointer }) => `/spec${pointer}`)}>
                <GroupFields group={group} />
              </Folded>
            ))}
          </section>
          <section class="card folds">
            <Folded title="Labels, files and queue" pointers={["/labels", "/outputs", "/bodies", "/units", "/backend", "/priority", "/reuse"]}>
              <MoreOptions />
            </Folded>
            <Folded title="The same request as code" pointers={[]}>
              <CodePanel />
            </Folded>
          </section>
        </div>
        <Summary />
      </div>
    </div>
  );
}

function Fields({ parameters }: { parameters: readonly Parameter[] }) {
  return (
    <div class="parameters">
      {parameters.map((parameter) => (
        <ParameterField key={parameter.pointer} parameter={parameter} />
      ))}
    </div>
  );
}

function GroupFields({ group }: { group: Group }) {
  return (
    <>
      {group.description && <p class="soft"><Marked text={group.description} /></p>}
      <Fields parameters={group.parameters} />
    </>
  );
}

/** A folded part; its title shows the numbers of changes and faults inside. */
function Folded({ title, pointers, children }: { title: string; pointers: readonly string[]; children: ComponentChildren }) {
  const changed = pointers.filter((pointer) => pointer.replace(/^\/spec/, "") in form.value.changes).length;
  const faulty = pointers.filter((pointer) => faults.value.has(pointer)).length;
  return (
    <details class="folded">
      <summary>
        <span class="folded-title">{title}</span>
        {changed > 0 && <span class="badge badge-running">{changed} changed</span>}
        {faulty > 0 && <span class="badge badge-failed">{faulty} to correct</span>}
      </summary>
      <div class="folded-content">{children}</div>
    </details>
  );
}

function Origin() {
  const from = origin.value;
  if (!from) return null;
  if ("failed" in from) {
    return (
      <Notice title="The link could not be followed as it is" kind="error">
        <p>{from.failed}</p>
      </Notice>
    );
  }
  return (
    <p class="soft">
      Filled in from the model <a class="mono" href={href(["models", from.id])}>{from.id}</a>.
    </p>
  );
}
