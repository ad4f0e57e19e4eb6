// A position along the tube: the cut of the surface or the simulated section, with its controls.
import { OviductError, type RingKind, type SlideUrlOptions } from "oviduct-client";
import { useMemo } from "preact/hooks";
import { ask, explain } from "../service.ts";
import { short } from "../ui/format.ts";
import { Icon, Notice, toast } from "../ui/widgets.tsx";
import { areas, ofCut, type CrossSection } from "./cross-section.ts";
import type { Lack } from "./cuts.ts";
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
  const { places: { value: places }, fractions } = exploration;
  const at = view.section.value;
  const z_um = exploration.planeOf(at);
  const z = `${short(z_um / 1000)} mm`;
  const index = exploration.indexAt(at);
  const shown = useShown(exploration, z_um, index);
  const { section, waiting } = shown;
  const look = view.look.value;
  const place: Place = { id: exploration.model.id, index, z_um };
  const step = index === undefined ? undefined : places!.step[index]!;
  return (
    <>
      <SectionSlider fractions={fractions.value} index={index} z={z} onChoose={(next) => view.goTo(next)} />
      <PlacesFault exploration={exploration} />
      <div class="looks" role="group" aria-label="Look of the cross section">
        {LOOKS.map((one) => (
          <button
            key={one}
            type="button"
            class="button"
            aria-pressed={one === look}
            onClick={() => (view.look.value = one)}
          >
            {LOOK_NAMES[one]}
          </button>
        ))}
      </div>
      {section
        ? <Pictured exploration={exploration} place={place} look={look} waiting={waiting} section={section} z={z} />
        : <div class="drawing"><div class="drawing-sheet drawing-empty" aria-busy={waiting} /></div>}
      <Caption {...shown} />
      <dl class="figures num">
        {index !== undefined && (
          <div>
            <dt>Section</dt>
            <dd>{index + 1} of {places!.z_mm.length}{Number.isInteger(step) ? "" : ", added"}</dd>
          </div>
        )}
        <div><dt>z</dt><dd>{z}</dd></div>
        {step !== undefined && <div><dt>Step</dt><dd>{short(step)}</dd></div>}
        {section && <Figures section={section} />}
      </dl>
      <div class="row">
        <button type="button" class="button" onClick={() => cutHere(view)}>
          <Icon name="cut" /> Cut the model here
        </button>
        <div class="row">
          {(["svg", "png", "json"] as const).map((kind) => (
            <button key={kind} type="button" class="button" onClick={() => save(exploration, place, kind, look)}>
              <Icon name="download" /> {kind.toUpperCase()}
            </button>
          ))}
        </div>
      </div>
    </>
  );
}

function cutHere(view: View): void {
  view.flight.value = undefined;
  view.position.value = view.section.peek();
  view.across.value = true;
}

interface SliderProps {
  /** Places of the sections; empty while they are unknown. */
  fractions: readonly number[];
  /** The section that is nearest to the shown place. */
  index: number | undefined;
  z: string;
  onChoose: (fraction: number) => void;
}

/** Moves from section to section. */
function SectionSlider({ fractions, index, z, onChoose }: SliderProps) {
  const last = fractions.length - 1;
  const choose = (k: number) => onChoose(fractions[Math.max(0, Math.min(last, k))]!);
  const known = index !== undefined;
  return (
    <>
      <div class="section-slider">
        <button
          type="button"
          class="button-icon"
          aria-label="Previous section"
          disabled={!known || index === 0}
          onClick={() => choose(index! - 1)}
        >
          ‹
        </button>
        <input
          type="range"
          min={0}
          max={Math.max(1, last)}
          value={index ?? 0}
          disabled={!known}
          aria-label="Section"
          aria-valuetext={known ? `${index + 1} of ${fractions.length}, ${z} from the isthmus` : z}
          onInput={(event) => choose(Number(event.currentTarget.value))}
        />
        <button
          type="button"
          class="button-icon"
          aria-label="Next section"
          disabled={!known || index === last}
          onClick={() => choose(index! + 1)}
        >
          ›
        </button>
      </div>
      <div class="section-ends small soft"><span>isthmus</span><span>ampulla</span></div>
    </>
  );
}

function PlacesFault({ exploration }: { exploration: Exploration }) {
  const { placesFault } = exploration;
  if (placesFault.value === undefined) return null;
  return (
    <Notice title="The places of the sections could not be loaded" kind="error">
      <p>{placesFault.value}</p>
      <button type="button" class="button" onClick={() => exploration.loadPlaces()}>Try again</button>
    </Notice>
  );
}

function Figures({ section }: { section: CrossSection }) {
  const points = section.contours.reduce((sum, { x }) => sum + x.length, 0);
  return (
    <>
      <div><dt>Tissue</dt><dd>{short(section.tissue / 1e6)} mm²</dd></div>
      <div><dt>Lumen</dt><dd>{short(section.lumen / 1e6)} mm²</dd></div>
      <div><dt>Points of the contours</dt><dd>{short(points)}</dd></div>
    </>
  );
}

/** The content at a place. */
interface Shown {
  /** Undefined until the first one has arrived. */
  section: CrossSection | undefined;
  /** True until the section is that of the place. */
  waiting: boolean;
  /** Reason why the simulated section is shown. */
  lack: Lack | undefined;
  /** Reason why the simulated section could not be loaded. */
  fault: string | undefined;
  again: () => void;
}

/** The cut at a place, or the nearest section if there is none; until it arrives, the last one. */
function useShown(exploration: Exploration, z_um: number, index: number | undefined): Shown {
  const { cuts, simulated } = exploration;
  const lack = exploration.lackAt(z_um);
  const outcome = cuts.outcome.value;
  const cut = lack ? undefined : outcome?.value?.cut;
  const drawn = useMemo(() => cut && ofCut(cut), [cut]);
  const instead = simulated.outcome.value;
  const isInstead = lack !== undefined && instead?.key === String(index);
  return {
    section: drawn ?? instead?.value,
    waiting: lack ? !isInstead : outcome?.key !== String(z_um),
    lack,
    fault: isInstead && instead.fault !== undefined ? explain(instead.fault) : undefined,
    again: () => {
      cuts.again();
      simulated.again();
    },
  };
}

const LOOK_NAMES: Record<Look, string> = { contours: "Contours", stained: "Stained", labels: "Tissues" };

function Caption({ section, waiting, lack, fault, again }: Shown) {
  if (!lack) {
    const kinds = ["island", "pocket"] satisfies RingKind[];
    const counts = section && kinds.map((kind) => census(areas(section, kind), kind)).join(", ");
    return (
      <p class="section-caption small" role="status" aria-busy={waiting}>
        {waiting ? "The surface is being cut …" : `Planar cut of the surface: ${counts}.`}
      </p>
    );
  }
  const failed = fault !== undefined;
  return (
    <p class="section-caption small" role="status" aria-busy={waiting}>
      Section of the simulation: {lack.why}{lack.fault ? "" : "."}{failed && ` It could not be loaded. ${fault}`}
      {(lack.fault || failed) && <> <button type="button" class="button" onClick={again}>Try again</button></>}
    </p>
  );
}

/** The shown cross section. */
interface Place {
  id: string;
  /** Index of the nearest section, if it is known. */
  index: number | undefined;
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
  const { id, index, z_um } = place;
  const { source } = section;
  const name = `${source} ${source === "surface" ? z_um : index} ${look}`;
  const want = (pixels: number) => {
    if (look === "contours" || waiting) {
      pictures.stop();
      return;
    }
    const size = sizeFor(pixels);
    pictures.want(`${name} ${size}`, async (signal) => {
      const options = { ...slideOptions(look, size), signal };
      const slide = await ask((service) => {
        if (source === "surface") return service.cutPicture(id, { z_um }, options);
        return service.sectionPicture(id, index!, options);
      });
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
  if (!isCut && index === undefined) return;
  try {
    const url = await ask((service) => {
      return isCut ? service.cutUrl(id, { z_um }, options) : service.sectionUrl(id, index!, options);
    });
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
