// Explores a finished model: in 3D, section by section, by its measures and files.
import { computed } from "@preact/signals";
import type { Model } from "oviduct-client";
import { useEffect, useMemo } from "preact/hooks";
import { Notice } from "../ui/widgets.tsx";
import { Contraction } from "./contraction.ts";
import { ContractionPanel } from "./contraction-panel.tsx";
import { CutPanel, DetailPanel, FlightPanel, PartsPanel, ViewButtons } from "./controls.tsx";
import type { Course } from "./course.ts";
import { useCourses } from "./courses.tsx";
import { Downloads } from "./downloads.tsx";
import { Exploration } from "./exploration.ts";
import { Flight } from "./flight.ts";
import { middleOf } from "./framing.ts";
import { keepLink } from "./link.ts";
import { MeasurePanel } from "./measure-panel.tsx";
import { Picture } from "./picture.tsx";
import { ProfileCharts } from "./profile-charts.tsx";
import { ReportPanel } from "./report-panel.tsx";
import { SectionView } from "./section-view.tsx";
import { View } from "./view.ts";
import { courseInWords } from "./words.ts";
import "./explore.css";

export default function Explore({ model }: { model: Model }) {
  if (!model.summary?.certificate) {
    return (
      <Notice title="There is nothing to explore">
        <p>The service keeps no figures of this model.</p>
      </Notice>
    );
  }
  return <WithCourse key={model.id} model={model} />;
}

function WithCourse({ model }: { model: Model }) {
  const { courses, instead } = useCourses([model]);
  return courses ? <Explorer model={model} course={courses[0]} /> : instead;
}

function Explorer({ model, course }: { model: Model; course: Course | undefined }) {
  const { exploration, view, flight, contraction } = useMemo(() => {
    const exploration = new Exploration(model, course);
    const view = new View(exploration.tube);
    return {
      exploration,
      view,
      flight: new Flight(
        view, exploration.tube.length, computed(() => !exploration.obstacle.value), exploration.passage.onward,
      ),
      contraction: new Contraction(model, view, exploration.tube),
    };
  }, []);
  const { tube, measurement } = exploration;
  useEffect(() => {
    const leave = keepLink(view, measurement);
    exploration.start(view);
    return () => {
      leave();
      flight.dispose();
      contraction.dispose();
      exploration.dispose();
    };
  }, []);
  return (
    <div class="explore">
      <section class="explore-model card" aria-label="Model in 3D">
        <Picture
          name={`model ${model.seed}`}
          exploration={exploration}
          view={view}
          flight={flight}
          contraction={contraction}
          section="explore-section"
        />
        <div class="explore-bar">
          <ViewButtons view={view} />
          {course && <p class="soft small num">{courseInWords(course)}</p>}
        </div>
      </section>
      <div class="explore-controls card">
        <CutPanel view={view} tubes={[tube]} />
        <PartsPanel view={view} />
        <FlightPanel explorations={[exploration]} view={view} flight={flight} />
        <ContractionPanel contraction={contraction} />
        <MeasurePanel measurement={measurement} middle={middleOf(tube)} />
        <DetailPanel exploration={exploration} view={view} contraction={contraction} />
      </div>
      <section class="explore-section card" aria-labelledby="explore-section">
        <h2 id="explore-section">Cross section</h2>
        <SectionView exploration={exploration} view={view} />
      </section>
      <section class="explore-profile card" aria-labelledby="explore-profile">
        <h2 id="explore-profile">Along the tube</h2>
        <ProfileCharts exploration={exploration} view={view} />
      </section>
      <section class="explore-report card" aria-labelledby="explore-report">
        <h2 id="explore-report">Report</h2>
        <ReportPanel exploration={exploration} />
      </section>
      <section class="explore-files card" aria-labelledby="explore-files">
        <h2 id="explore-files">Files</h2>
        <Downloads model={model} />
      </section>
    </div>
  );
}
