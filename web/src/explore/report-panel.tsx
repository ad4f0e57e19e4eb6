// Certificate and measures of a model.
import type { Report } from "oviduct-client";
import { ask, base, explain, key } from "../service.ts";
import { micrometres, short } from "../ui/format.ts";
import { Notice, toast } from "../ui/widgets.tsx";
import { ComparisonTable } from "./comparison.tsx";
import type { Exploration } from "./exploration.ts";
import type { Tube } from "./framing.ts";
import { islands } from "./words.ts";

type Certificate = Report["certificate"];

/** The statements of a certificate in words, and whether each holds. */
export function statements(certificate: Certificate): { text: string; holds: boolean }[] {
  const { open_edges, non_manifold_edges, non_manifold_vertices, disoriented_edges, triangle_intersections, section_crossings, components } = certificate;
  return [
    { text: "The surface is closed: no edge is open.", holds: certificate.closed && open_edges === 0 },
    { text: "It is a manifold: every edge has two triangles, every vertex one fan.", holds: certificate.manifold && non_manifold_edges + non_manifold_vertices === 0 },
    { text: "All triangles face outwards.", holds: certificate.oriented && disoriented_edges === 0 },
    { text: "No two triangles intersect.", holds: triangle_intersections === 0 },
    { text: "No contour crosses itself, and the mucosa lies within the wall.", holds: section_crossings === 0 },
    { text: "No triangle is degenerate or doubled.", holds: certificate.degenerate_triangles + certificate.duplicate_triangles === 0 },
    { text: "The tissue is one piece with one passage through it.", holds: components === 1 && certificate.euler === 0 },
  ];
}

function figures({ certificate, summary, engine, seed }: Report, { length, course }: Tube): [string, string][] {
  const { min_gap_um } = certificate;
  return [
    ["Volume of the tissue", `${short(certificate.volume_mm3)} mm³`],
    ["Area of the surface", `${short(certificate.area_mm2)} mm²`],
    [course ? "Length along the centre line" : "Length", `${short(length)} mm`],
    ["Smallest gap", min_gap_um == null ? "unknown" : micrometres(min_gap_um)],
    ["Triangles", short(certificate.triangles)],
    ["Vertices", short(certificate.vertices)],
    ["Smallest angle", `${short(certificate.min_angle_deg)}°`],
    ["Triangles with no angle below 20°", certificate.quality ? `${short(100 * certificate.quality.least_angles_from_20)} %` : "unknown"],
    ["Shortest edge", micrometres(certificate.min_edge_um)],
    ["Sections", `${short(summary.sections)}${summary.sections_added ? ` and ${short(summary.sections_added)} added` : ""}`],
    ["Particles", `${short(summary.particles.start)} to ${short(summary.particles.end)}`],
    ["Seed", String(seed)],
    ["Engine", engine],
  ];
}

export function ReportPanel({ exploration }: { exploration: Exploration }) {
  const { report, reportFault } = exploration;
  if (reportFault.value !== undefined) {
    return (
      <Notice title="The report could not be loaded" kind="error">
        <p>{reportFault.value}</p>
        <button type="button" class="button" onClick={() => exploration.loadReport()}>Try again</button>
      </Notice>
    );
  }
  if (!report.value) return <p class="soft" aria-busy="true">Loading the report …</p>;
  const { certificate, summary, comparison } = report.value;
  const cut = islands(report.value);
  return (
    <div class="report">
      <div>
        <p>
          <strong class={certificate.passed ? "holds" : "fails"}>{certificate.passed ? "Certified" : "Not certified"}</strong>
          <span class="soft"> by exact tests of the surface as exported</span>
        </p>
        <ul class="statements">
          {statements(certificate).map(({ text, holds }) => (
            <li key={text} class={holds ? "holds" : "fails"}>
              <span class="visually-hidden">{holds ? "Proven: " : "Does not hold: "}</span>
              <span class="statement">{text}</span>
            </li>
          ))}
        </ul>
        {(summary.warnings ?? []).map(({ code, detail }) => (
          <p key={code} class="warning">{detail}</p>
        ))}
        <dl class="figures num">
          {figures(report.value, exploration.tube).map(([name, value]) => (
            <div key={name}><dt>{name}</dt><dd>{value}</dd></div>
          ))}
        </dl>
        {cut !== undefined && <p>{cut}</p>}
        <p class="report-page"><ReportPage id={exploration.model.id} /></p>
      </div>
      {comparison && <ComparisonTable comparison={comparison} />}
    </div>
  );
}

const PAGE = "Report as a page";

/**
 * Opens the report page to view or print. With an API key, its URL contains a ticket, created on
 * request.
 */
function ReportPage({ id }: { id: string }) {
  if (key.value === undefined) {
    return <a class="button" href={new URL(`models/${id}/report.html`, base).href} target="_blank" rel="noopener">{PAGE}</a>;
  }
  const open = async () => {
    // Open the window immediately; browsers block windows that are opened later.
    const page = window.open("", "_blank");
    if (page) page.opener = null;
    try {
      const url = await ask((service) => service.reportPageUrl(id));
      (page ?? window).location.assign(url);
    } catch (error) {
      page?.close();
      toast(explain(error), "error");
    }
  };
  return <button type="button" class="button" onClick={open}>{PAGE}</button>;
}
