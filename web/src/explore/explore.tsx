// Explores a finished model: in 3D, section by section, by its figures and files.
import type { Model } from "oviduct-client";
import { useEffect, useMemo } from "preact/hooks";
import { Notice } from "../ui/widgets.tsx";
import { CutPanel, DetailPanel, FlightPanel, PartsPanel, ViewButtons } from "./controls.tsx";
import { Downloads } from "./downloads.tsx";
import { Exploration } from "./exploration.ts";
import { Flight } from "./flight.ts";
import { keepLink } from "./link.ts";
import { MeasurePanel } from "./measure-panel.tsx";
import { Picture } from "./picture.tsx";
import { ProfileCharts } from "./profile-charts.tsx";
import { ReportPanel } from "./report-panel.tsx";
import { SectionView } from "./section-view.tsx";
import { View } from "./view.ts";
import "./explore.css";

export default function Explore({ model }: { model: Model }) {
  if (!model.summary?.certificate) {
    return (
      <Notice title="There is nothing to explore">
        <p>The service keeps no figures of this model.</p>
      </Notice>
    );
  }
  return <Explorer key={model.id} model={model} />;
}

function Explorer({ model }: { model: Model }) {
  const { exploration, view, flight } = useMemo(() => {
    const exploration = new Exploration(model);
    const view = new View(exploration.tube);
    return { exploration, view, flight: new Flight(view, exploration.tube.length) };
  }, []);
  const { tube, measurement } = exploration;
  useEffect(() => {
    exploration.start();
    const leave = keepLink(view, measurement);
    return () => {
      leave();
      flight.dispose();
      exploration.dispose();
    };
  }, []);
  return (
    <div class="explore">
      <section class="explore-model card" aria-label="Model in 3D">
        <Picture name={`model ${model.seed}`} exploration={exploration} view={view} flight={flight} />
        <div class="explore-bar">
          <ViewButtons view={view} />
        </div>
      </section>
      <div class="explore-controls card">
        <CutPanel view={view} tubes={[tube]} />
        <PartsPanel view={view} />
        <FlightPanel explorations={[exploration]} view={view} flight={flight} />
        <MeasurePanel measurement={measurement} middle={{ x: tube.x, y: tube.y, z: tube.length / 2 }} />
        <DetailPanel exploration={exploration} />
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
