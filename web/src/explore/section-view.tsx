// A position along the tube: the cut of the surface or the simulated section, with its controls.
import { OviductError, type Section, type Sections, type SlideUrlOptions } from "oviduct-client";
import { useMemo } from "preact/hooks";
import { ask, explain } from "../service.ts";
import { bytes, short } from "../ui/format.ts";
import { Icon, Notice, toast } from "../ui/widgets.tsx";
import { nearestIndex } from "./ascending.ts";
import { areas, ofCut, ofSection, type CrossSection } from "./cross-section.ts";
import type { Exploration } from "./exploration.ts";
import { Drawing } from "./section-drawing.tsx";
import { LOOKS, TISSUES, pictureOf, sizeFor, slideOptions, type Look, type Picture } from "./slides.ts";
import type { View } from "./view.ts";
import { census } from "./words.ts";

interface Props {
  exploration: Exploration;
  view: View;
}

export function SectionView({ exploration, view }: Props) {
  const { sections, sectionsFault, fractions, model } = exploration;
  if (sectionsFault.value !== undefined) {
    return (
      <Notice title="The sections could not be loaded" kind="error">
        <p>{sectionsFault.value}</p>
        <button type="button" class="button" onClick={() => exploration.loadSections()}>Try again</button>
      </Notice>
    );
  }
  if (!sections.value) {
    const size = model.files.find((file) => file.name === "sections.bin")?.bytes;
    return <p class="soft" aria-busy="true">Loading the sections{size === undefined ? "" : ` (${bytes(size)})`} …</p>;
  }
  const index = nearestIndex(fractions.value, view.section.value);
  return <Loaded exploration={exploration} view={view} sections={sections.value} index={index} />;
}

/** The content at a position. */
interface Shown {
  section: CrossSection;
  /** True while the surface is being cut. */
  waiting: boolean;
  /** Reason why the simulated section is shown. */
  why?: string | undefined;
  /** The reason, if a retry may succeed. */
  fault?: string | undefined;
}

/** The cut at a place; the nearest section until the cut arrives or if there is none. */
function useShown({ cuts, uncut }: Exploration, section: Section, z_um: number): Shown {
  const key = String(z_um);
  const { value: outcome } = cuts.outcome;
  // Until the next cut arrives, the last one stays.
  const cut = outcome?.value?.cut;
  const shown = useMemo(() => (cut ? ofCut(cut) : ofSection(section)), [cut ?? section]);
  const { value, fault } = outcome?.key === key ? outcome : {};
  const why = uncut.value ?? (value && !value.cut ? value.why : undefined);
  return {
    section: shown,
    waiting: why === undefined && outcome?.key !== key,
    why,
    fault: fault === undefined ? undefined : explain(fault),
  };
}

function Loaded({ exploration, view, sections, index }: Props & { sections: Sections; index: number }) {
  const stored = useMemo(() => sections.section(index), [sections, index]);
  const z_um = exploration.planeOf(view.section.value);
  const shown = useShown(exploration, stored, z_um);
  const { section, waiting } = shown;
  const choose = (k: number) => (view.section.value = exploration.fractions.peek()[Math.max(0, Math.min(sections.length - 1, k))]!);
  const z = `${short(z_um / 1000)} mm`;
  const cutHere = () => {
    view.flight.value = undefined;
    view.position.value = view.section.peek();
    view.across.value = true;
  };
  const place: Place = { id: exploration.model.id, source: section.source, index, z_um };
  const points = section.contours.reduce((sum, { x }) => sum + x.length, 0);
  return (
    <>
      <div class="section-slider">
        <button type="button" class="button-icon" aria-label="Previous section" disabled={index === 0} onClick={() => choose(index - 1)}>‹</button>
        <input
          type="range"
          min={0}
          max={sections.length - 1}
          value={index}
          aria-label="Section"
          aria-valuetext={`${index + 1} of ${sections.length}, ${z} from the isthmus`}
          onInput={(event) => choose(Number(event.currentTarget.value))}
        />
        <button type="button" class="button-icon" aria-label="Next section" disabled={index === sections.length - 1} onClick={() => choose(index + 1)}>›</button>
      </div>
      <div class="section-ends small soft"><span>isthmus</span><span>ampulla</span></div>
      <div class="looks" role="group" aria-label="Look of the cross section">
        {LOOKS.map((look) => (
          <button key={look} type="button" class="button" aria-pressed={view.look.value === look} onClick={() => (view.look.value = look)}>{LOOK_NAMES[look]}</button>
        ))}
      </div>
      <Pictured exploration={exploration} place={place} look={view.look.value} waiting={waiting} section={section} z={z} />
      <Caption {...shown} again={() => exploration.cuts.again()} />
      <dl class="figures num">
        <div><dt>Section</dt><dd>{index + 1} of {sections.length}{stored.added ? ", added" : ""}</dd></div>
        <div><dt>z</dt><dd>{z}</dd></div>
        <div><dt>Step</dt><dd>{short(stored.step)}</dd></div>
        <div><dt>Tissue</dt><dd>{short(section.tissue / 1e6)} mm²</dd></div>
        <div><dt>Lumen</dt><dd>{short(section.lumen / 1e6)} mm²</dd></div>
        <div><dt>Points of the contours</dt><dd>{short(points)}</dd></div>
      </dl>
      <div class="row">
        <button type="button" class="button" onClick={cutHere}><Icon name="cut" /> Cut the model here</button>
        <div class="row">
          {(["svg", "png", "json"] as const).map((kind) => (
            <button key={kind} type="button" class="button" onClick={() => save(exploration, place, kind, view.look.peek())}>
              <Icon name="download" /> {kind.toUpperCase()}
            </button>
          ))}
        </div>
      </div>
    </>
  );
}

const LOOK_NAMES: Record<Look, string> = { contours: "Contours", stained: "Stained", labels: "Tissues" };

function Caption({ section, waiting, why, fault, again }: Shown & { again: () => void }) {
  if (section.source === "surface") {
    return (
      <p class="section-caption small" role="status" aria-busy={waiting}>
        {waiting
          ? "The surface is being cut …"
          : `Planar cut of the surface: ${census(areas(section, "island"), "island")}, ${census(areas(section, "pocket"), "pocket")}.`}
      </p>
    );
  }
  return (
    <p class="section-caption small" role="status" aria-busy={waiting}>
      Section of the simulation{waiting ? "; the surface is being cut …" : `: ${why ?? fault ?? ""}${why === undefined ? "" : "."}`}
      {fault !== undefined && <> <button type="button" class="button" onClick={again}>Try again</button></>}
    </p>
  );
}

/** The shown cross section. */
interface Place {
  id: string;
  source: CrossSection["source"];
  index: number;
  z_um: number;
}

interface PicturedProps {
  exploration: Exploration;
  place: Place;
  look: Look;
  waiting: boolean;
  section: CrossSection;
  z: string;
}

/** The drawing, with a picture over it after the picture has loaded. */
function Pictured({ exploration: { pictures }, place, look, waiting, section, z }: PicturedProps) {
  const { id, source, index, z_um } = place;
  const name = `${source} ${source === "surface" ? z_um : index} ${look}`;
  const want = (pixels: number) => {
    if (look === "contours" || waiting) {
      pictures.stop();
      return;
    }
    const size = sizeFor(pixels);
    pictures.want(`${name} ${size}`, async (signal) => {
      const options = { ...slideOptions(look, size), signal };
      const slide = await ask((service) => (source === "surface" ? service.cutPicture(id, { z_um }, options) : service.sectionPicture(id, index, options)));
      return pictureOf(slide, look);
    });
  };
  const { value: outcome } = pictures.outcome;
  const isOurs = outcome?.key.startsWith(`${name} `) ?? false;
  const picture: Picture | undefined = isOurs ? outcome!.value : undefined;
  const fault = isOurs && pictures.awaited.value === undefined ? outcome!.fault : undefined;
  const note = look === "contours" || picture ? undefined : fault === undefined ? (
    <p class="drawing-note small" aria-busy="true">Drawing the picture …</p>
  ) : (
    <p class="drawing-note small" role="alert">
      {explain(fault)} <button type="button" class="button" onClick={() => pictures.again()}>Try again</button>
    </p>
  );
  return (
    <Drawing section={section} z={z} look={look} name={name} waiting={waiting} picture={picture} note={note} onPixels={want}>
      <Legend section={section} look={look} />
    </Drawing>
  );
}

function Legend({ section, look }: { section: CrossSection; look: Look }) {
  if (look === "stained") return null;
  if (look === "labels") {
    return (
      <ul class="drawing-legend small">
        {TISSUES.map(({ name, color }) => (
          <li key={name}><span class="drawing-key" style={{ background: color }} /> {name}</li>
        ))}
      </ul>
    );
  }
  const kinds = [["tissue", "Tissue"], ["lumen", "Lumen"], ["island", "Island"], ["pocket", "Pocket"]] as const;
  return (
    <ul class="drawing-legend small">
      {kinds.filter(([kind]) => section.contours.some((contour) => contour.kind === kind)).map(([kind, name]) => (
        <li key={kind}><span class={`drawing-key key-${kind}`} /> {name}</li>
      ))}
    </ul>
  );
}

/** Longest side of a saved picture, pixels. */
const PIXELS = 2048;

/**
 * Saves a cross section. A link needs a new ticket each time, so the URL is requested on demand.
 */
async function save({ cuts }: Exploration, { id, index, z_um }: Place, kind: "svg" | "png" | "json", look: Look): Promise<void> {
  const stained = kind === "png" && look !== "contours" ? look : undefined;
  // The service draws no pictures of contours, so the page converts the drawing.
  const isDrawn = kind === "png" && !stained;
  const options: SlideUrlOptions = { format: isDrawn ? "svg" : kind, ...(stained && slideOptions(stained, PIXELS)) };
  // Save the content that will be shown.
  await cuts.settled();
  const outcome = cuts.outcome.peek();
  const isCut = outcome?.key === String(z_um) && outcome.value?.cut !== undefined;
  try {
    const url = await ask((service) => (isCut ? service.cutUrl(id, { z_um }, options) : service.sectionUrl(id, index, options)));
    const link = document.createElement("a");
    link.href = isDrawn ? await pngOf(url) : url;
    const name = isCut ? `cut-${Math.round(z_um)}um` : `section-${index}`;
    link.download = `${name}${stained ? `-${stained}` : ""}.${kind}`;
    link.click();
    if (isDrawn) URL.revokeObjectURL(link.href);
  } catch (error) {
    toast(explain(error), "error");
  }
}

/** The object URL of a drawing as PNG. */
async function pngOf(drawing: string): Promise<string> {
  const response = await fetch(drawing);
  if (!response.ok) throw await OviductError.of(response);
  const svg = await response.text();
  const [width, height] = /viewBox="\S+ \S+ (\S+) (\S+)"/.exec(svg)!.slice(1).map(Number) as [number, number];
  const scale = PIXELS / Math.max(width, height);
  const canvas = document.createElement("canvas");
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const image = new Image();
  // Some browsers do not draw an image without a size.
  const sized = svg.replace("<svg ", `<svg width="${canvas.width}" height="${canvas.height}" `);
  image.src = URL.createObjectURL(new Blob([sized], { type: "image/svg+xml" }));
  await image.decode();
  URL.revokeObjectURL(image.src);
  canvas.getContext("2d")!.drawImage(image, 0, 0);
  const png = await new Promise<Blob | null>((resolve) => canvas.toBlob(resolve));
  return URL.createObjectURL(png!);
}
