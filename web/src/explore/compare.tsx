// Two models side by side with the same camera and the same cuts. Bent models have separate
// cameras.
import { computed } from "@preact/signals";
import type { Model } from "oviduct-client";
import { useEffect, useMemo, useState } from "preact/hooks";
import { state } from "../models.ts";
import { href, link, route } from "../router.ts";
import { ask, explain } from "../service.ts";
import { reconnections } from "../stream.ts";
import { micrometres, short } from "../ui/format.ts";
import { CopyButton, Notice } from "../ui/widgets.tsx";
import { CutPanel, DetailPanel, FlightPanel, PartsPanel, ViewButtons } from "./controls.tsx";
import type { Course } from "./course.ts";
import { useCourses } from "./courses.tsx";
import { Exploration } from "./exploration.ts";
import { Flight } from "./flight.ts";
import { middleOf } from "./framing.ts";
import { keepLink } from "./link.ts";
import { MeasurePanel } from "./measure-panel.tsx";
import { Picture } from "./picture.tsx";
import { SectionView } from "./section-view.tsx";
import { View } from "./view.ts";
import { courseInWords } from "./words.ts";
import "./explore.css";

export default function Compare() {
  const [, a = "", b = ""] = route.peek().path;
  const [models, setModels] = useState<readonly [Model, Model]>();
  const [fault, setFault] = useState<string>();
  const [attempts, setAttempts] = useState(0);
  const lacking = models?.filter((model) => !model.summary?.certificate) ?? [];
  const comparable = models !== undefined && lacking.length === 0;
  useEffect(() => {
    // Models that have succeeded never change.
    if (comparable) return;
    const abort = new AbortController();
    const get = (id: string) => ask((service) => service.get(id, { signal: abort.signal }));
    Promise.all([get(a), get(b)]).then(
      (models) => {
        setModels(models);
        setFault(undefined);
      },
      (error: unknown) => abort.signal.aborted || setFault(explain(error)),
    );
    return () => abort.abort();
  }, [state(a).value?.status, state(b).value?.status, reconnections.value, attempts]);
  if (comparable) return <WithCourses models={models} />;
  if (fault !== undefined) {
    return (
      <Notice title="The models could not be loaded" kind="error">
        <p>{fault}</p>
        <button type="button" class="button" onClick={() => setAttempts(attempts + 1)}>Try again</button>
      </Notice>
    );
  }
  if (!models) return <p class="soft" aria-busy="true">Loading …</p>;
  return (
    <Notice title={lacking.every(hasSucceeded) ? "There is nothing to compare" : "Only finished models can be compared"}>
      {lacking.map((model) => {
        const name = <a href={href(["models", model.id])}>{nameOf(model)}</a>;
        return <p key={model.id}>{hasSucceeded(model) ? <>The service keeps no figures of {name}.</> : <>{name} is {model.status}.</>}</p>;
      })}
    </Notice>
  );
}

function WithCourses({ models }: { models: readonly [Model, Model] }) {
  const { courses, instead } = useCourses(models);
  return courses ? <Comparison models={models} courses={courses} /> : instead;
}

function Comparison({ models, courses }: { models: readonly [Model, Model]; courses: readonly (Course | undefined)[] }) {
  const { explorations, view, flight } = useMemo(() => {
    const explorations = models.map((model, k) => new Exploration(model, courses[k]));
    const { tube: longest, passage } = explorations.reduce((a, b) => (b.tube.length > a.tube.length ? b : a));
    const radius = Math.max(...explorations.map(({ tube }) => tube.radius));
    // Bent tubes point in different directions, so each one is framed separately.
    const view = courses.some(Boolean) ? new View(explorations[0]!.tube, explorations[1]!.tube) : new View({ ...longest, radius });
    const ready = computed(() => explorations.every(({ obstacle }) => !obstacle.value));
    return { explorations, view, flight: new Flight(view, longest.length, ready, passage.onward) };
  }, []);
  useEffect(() => {
    const leave = keepLink(view);
    for (const exploration of explorations) exploration.start(view);
    return () => {
      leave();
      flight.dispose();
      for (const exploration of explorations) exploration.dispose();
    };
  }, []);
  return (
    <>
      <div class="page-head">
        <h1>Compare</h1>
        <ViewButtons view={view} />
        <div class="actions"><CopyButton label="Copy link" text={link} /></div>
      </div>
      <div class="compare">
        {explorations.map((exploration, k) => (
          <section key={k} class="compare-model card" aria-label={ordinalName(exploration.model, k)}>
            <Head model={exploration.model} words={courses.some(Boolean) ? courseInWords(courses[k]) : undefined} />
            <Picture
              name={ordinalName(exploration.model, k)}
              exploration={exploration}
              view={view}
              flight={flight}
              section={sectionId(k)}
            />
          </section>
        ))}
        <div class="compare-controls card">
          <CutPanel view={view} tubes={explorations.map(({ tube }) => tube)} />
          <PartsPanel view={view} />
          <FlightPanel explorations={explorations} view={view} flight={flight} />
        </div>
        {explorations.map((exploration, k) => {
          const { tube, model } = exploration;
          return (
            <section
              key={k}
              id={sectionId(k)}
              class="compare-section card"
              aria-label={`Cross section of ${ordinalName(model, k)}`}
            >
              <SectionView exploration={exploration} view={view} />
              <MeasurePanel measurement={exploration.measurement} middle={middleOf(tube)} />
              <DetailPanel exploration={exploration} view={view} />
            </section>
          );
        })}
      </div>
    </>
  );
}

function sectionId(k: number): string {
  return `compare-section-${k}`;
}

function hasSucceeded({ status }: Model): boolean {
  return status === "succeeded";
}

function nameOf({ preset, seed }: Model): string {
  return `${preset}, seed ${seed}`;
}

/** Name of a model in the comparison; both may have the same preset and seed. */
function ordinalName(model: Model, k: number): string {
  return `the ${k === 0 ? "first" : "second"} model, ${nameOf(model)}`;
}

function Head({ model, words }: { model: Model; words: string | undefined }) {
  const { summary } = model;
  return (
    <header class="compare-head">
      <h2><a href={href(["models", model.id])}>{nameOf(model)}</a></h2>
      {summary && (
        <p class="soft small num">
          {short(summary.volume_mm3)} mm³ of tissue, {short(summary.area_mm2)} mm² of surface
          {summary.min_gap_um == null ? "" : `, smallest gap ${micrometres(summary.min_gap_um)}`}, {short(summary.particles.end)} particles
        </p>
      )}
      {words && <p class="soft small num">{words}</p>}
    </header>
  );
}
