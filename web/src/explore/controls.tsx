// Controls of the 3D picture: views, cuts, parts, levels of detail and flight.
import { useComputed, type Signal } from "@preact/signals";
import type { ComponentChildren } from "preact";
import { useId } from "preact/hooks";
import { bytes, micrometres, millimetres, short } from "../ui/format.ts";
import { stillness } from "../ui/theme.ts";
import { Icon } from "../ui/widgets.tsx";
import type { Contraction } from "./contraction.ts";
import type { Exploration } from "./exploration.ts";
import { SPEEDS, type Flight } from "./flight.ts";
import type { Tube } from "./framing.ts";
import { glideFrom } from "./motion.ts";
import { STANDARD_VIEWS } from "./pose.ts";
import type { View } from "./view.ts";

const VIEW_TITLES = { whole: "Whole", isthmus: "Isthmus", ampulla: "Ampulla", side: "Side" };

export function ViewButtons({ view }: { view: View }) {
  const standard = useComputed(() => (void view.pose.changes.value, view.pose.standard));
  return (
    <div class="row views" role="group" aria-label="Views">
      {STANDARD_VIEWS.map((name) => (
        <button
          key={name}
          type="button"
          class="button"
          aria-pressed={standard.value === name && !view.flying.value}
          onClick={() => {
            view.flight.value = undefined;
            view.show(name, glideFrom());
          }}
        >
          {VIEW_TITLES[name]}
        </button>
      ))}
    </div>
  );
}

/** `tubes` are the tubes to cut. */
export function CutPanel({ view, tubes }: { view: View; tubes: readonly Tube[] }) {
  const flying = view.flying.value;
  return (
    <Panel title="Cut open">
      <Toggle label="Lengthwise" on={view.lengthwise} disabled={flying} />
      {view.lengthwise.value && (
        <Slider label="Angle" value={view.angle} min={-180} max={180} step={1} text={(angle) => `${Math.round(angle)}°`} />
      )}
      <Toggle label="Across" on={view.across} disabled={flying} />
      {view.across.value && (
        <>
          <Slider label="Position" value={view.position} min={0} max={1} step={0.001} text={(at) => millimetres(tubes.map(({ begin, length }) => begin + at * length))} />
          <Toggle label="Remove the isthmus side" on={view.flipped} />
        </>
      )}
      {tubes.some(({ course }) => course) && <p class="soft small">Both follow the centre line of the tube.</p>}
    </Panel>
  );
}

export function PartsPanel({ view }: { view: View }) {
  return (
    <Panel title="Show">
      <Toggle label="Inner wall (mucosa)" on={view.shown.inner} />
      <Toggle label="Outer wall" on={view.shown.outer} />
      <Toggle label="Outer wall translucent" on={view.translucent} disabled={!view.shown.outer.value} />
      <Toggle label="Caps at the ends" on={view.shown.caps} />
      <Toggle label="Plane of the section" on={view.plane} />
    </Panel>
  );
}

interface DetailProps {
  exploration: Exploration;
  view: View;
  contraction?: Contraction;
}

export function DetailPanel({ exploration, view, contraction }: DetailProps) {
  const { levels, level, loading, surface } = exploration;
  if (levels.length === 0) return null;
  const difference = surface.value?.difference;
  const chosen = loading.value?.level ?? level.value;
  const moving = contraction?.shown.value !== undefined;
  return (
    <Panel title="Detail">
      <div class="levels" role="group" aria-label="Level of detail">
        {levels.map((one) => (
          <button
            key={one.title}
            type="button"
            class="button"
            aria-pressed={one === chosen}
            disabled={moving || (view.flying.value && exploration.isTooCoarse(one))}
            onClick={() => exploration.loadLevel(one)}
          >
            {one.title} <span class="soft num">{bytes(one.file.bytes)}</span>
          </button>
        ))}
      </div>
      {moving && <p class="soft small">The contraction has one level of detail; these are of the tube at rest.</p>}
      {surface.value && !moving && (
        <p class="soft small num">
          {short(surface.value.triangles)} triangles are shown.
          {difference && <> Largest measured distance from the certified surface: {micrometres(difference.distance)}.</>}
          {difference && difference.precision.length > 0 && <> Positions are rounded to {difference.precision.map(short).join(", ")} µm along x, y, z.</>}
        </p>
      )}
    </Panel>
  );
}

/** Tolerance in millimetres for equal lengths of tubes. */
const ROUNDING = 1e-3;

/** Flies through all tubes simultaneously. */
export function FlightPanel({ explorations, view, flight }: { explorations: readonly Exploration[]; view: View; flight: Flight }) {
  const obstacle = explorations.map(({ passage }) => passage.obstacle.value).find(Boolean);
  const lengths = explorations.map(({ tube }) => tube.length);
  const speed = useId();
  if (!view.flying.value) {
    return (
      <Panel title="Fly through the lumen">
        <button type="button" class="button" disabled={obstacle?.state === "none"} onClick={() => flight.start()}>
          <Icon name="plane" /> Fly from the isthmus
        </button>
        {obstacle && <p class="soft small">{obstacle.words}</p>}
      </Panel>
    );
  }
  const playing = flight.playing.value;
  return (
    <Panel title="Fly through the lumen">
      <div class="row">
        <button type="button" class="button-icon" aria-label={playing ? "Pause" : "Play"} onClick={() => flight.toggle()}>
          <Icon name={playing ? "pause" : "play"} />
        </button>
        <label class="visually-hidden" for={speed}>Speed</label>
        <select id={speed} value={flight.speed.value} onChange={(event) => (flight.speed.value = Number(event.currentTarget.value))}>
          {SPEEDS.map((value) => (
            <option key={value} value={value}>{value} mm/s</option>
          ))}
        </select>
        <button type="button" class="button" onClick={() => flight.leave()}>Leave</button>
      </div>
      <Slider label="Along the tube" value={flight.shown} onInput={(at) => (view.flight.value = at)} min={0} max={1} step={0.0005} text={(at) => millimetres(explorations.map(({ tube }) => tube.begin + at * tube.length))} />
      <p class="soft small">
        Drag the picture to look around. Rings mark every 0.1 mm, dark ones every millimetre.
        {stillness.value && " Play moves the camera; it does not start by itself."}
        {Math.max(...lengths) - Math.min(...lengths) > ROUNDING && " The speed is that in the longer tube."}
      </p>
    </Panel>
  );
}

export function Panel({ title, children }: { title: string; children: ComponentChildren }) {
  const heading = useId();
  return (
    <section class="panel" aria-labelledby={heading}>
      <h2 id={heading}>{title}</h2>
      {children}
    </section>
  );
}

export function Toggle({ label, on, disabled }: { label: string; on: Signal<boolean>; disabled?: boolean }) {
  return (
    <label class="toggle">
      <input type="checkbox" checked={on.value} disabled={disabled} onChange={(event) => (on.value = event.currentTarget.checked)} />
      {label}
    </label>
  );
}

interface SliderProps {
  label: string;
  value: Signal<number>;
  min: number;
  max: number;
  step: number;
  text: (value: number) => string;
  /** Called with the new value; the caller updates `value`. */
  onInput?: (value: number) => void;
}

export function Slider({ label, value, min, max, step, text, onInput = (next) => (value.value = next) }: SliderProps) {
  const id = useId();
  return (
    <div class="slider">
      <label for={id}>{label}</label>
      <output for={id} class="num">{text(value.value)}</output>
      <input
        id={id}
        type="range"
        min={min}
        max={max}
        step={step}
        value={value.value}
        aria-valuetext={text(value.value)}
        onInput={(event) => onInput(Number(event.currentTarget.value))}
      />
    </div>
  );
}
