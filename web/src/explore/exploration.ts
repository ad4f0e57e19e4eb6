// Loaded data of one explored model: levels of detail, report, cuts and sections.
import { batch, computed, effect, signal, untracked } from "@preact/signals";
import type { Model, Report } from "oviduct-client";
import { ask, explain } from "../service.ts";
import { reconnections } from "../stream.ts";
import { nearestIndex } from "./ascending.ts";
import type { Course } from "./course.ts";
import { ofSection, type CrossSection } from "./cross-section.ts";
import { answered, planeAt, type Answer, type Lack } from "./cuts.ts";
import type { Tube } from "./framing.ts";
import { Latest } from "./latest.ts";
import { Measurement } from "./measure.ts";
import { Passage, type Obstacle } from "./passage.ts";
import { placesIn, placesOf, type Places } from "./places.ts";
import type { Picture } from "./slides.ts";
import type { View } from "./view.ts";
import { device } from "./viewer/device.ts";
import { automaticLevel, levelsOf, type Level } from "./viewer/levels.ts";
import { readSurface, type Surface } from "./viewer/surface.ts";

/** Index of the coarsest level of detail whose walls a flight can pass. */
const FLIGHT_LEVEL = 1;

export class Exploration {
  readonly model: Model;
  readonly tube: Tube;
  readonly levels: readonly Level[];
  readonly surface = signal<Surface | undefined>(undefined);
  /** Level of detail of `surface`. */
  readonly level = signal<Level | undefined>(undefined);
  /** The loading level of detail, and the number of its received bytes. */
  readonly loading = signal<{ level: Level; received: number } | undefined>(undefined);
  /** Reason why a level of detail failed, and the levels left to load, starting with that level. */
  readonly surfaceFault = signal<{ reason: string; left: readonly Level[] } | undefined>(undefined);
  /** Planar cuts by their position along the tube in micrometres. */
  readonly cuts = new Latest<Answer>(120, 30);
  /** Reason why no plane can cut the surface. */
  readonly uncut = signal<string | undefined>(undefined);
  /** Simulated sections by their index, where there is no cut. */
  readonly simulated = new Latest<CrossSection>(120, 8);
  /** Pictures of cross sections. */
  readonly pictures = new Latest<Picture>(200, 8, ({ url }) => URL.revokeObjectURL(url));
  readonly report = signal<Report | undefined>(undefined);
  readonly reportFault = signal<string | undefined>(undefined);
  /** Places of the simulated sections. */
  readonly places = signal<Places | undefined>(undefined);
  /** Reason why the places, which the report does not list, could not be loaded. */
  readonly placesFault = signal<string | undefined>(undefined);
  readonly measurement = new Measurement();
  /** The way of the flight. */
  readonly passage: Passage;
  /** Reason why a flight cannot begin; undefined if it can. */
  readonly obstacle = computed<Obstacle | undefined>(() => {
    const obstacle = this.passage.obstacle.value;
    if (obstacle) return obstacle;
    const [level, needed] = [this.level.value, this.#flightLevel];
    if (!needed || (level && !this.isTooCoarse(level))) return undefined;
    const title = needed.title.toLowerCase();
    if (this.surfaceFault.value) return { words: `The flight needs ${title} detail.`, state: "failed" };
    return { words: `The flight begins when ${title} detail is loaded.`, state: "waiting" };
  });
  /** Places of the sections as fractions of the tube's length. */
  readonly fractions = computed(() => {
    const { begin, length } = this.tube;
    return this.places.value?.z_mm.map((z) => (z - begin) / length) ?? [];
  });
  readonly #abort = new AbortController();
  #surfaceLoad = new AbortController();
  /** Levels of detail that are being loaded or will be. */
  #planned: readonly Level[] = [];
  #leave = () => {};

  /** Bent models require their course. */
  constructor(model: Model, course?: Course) {
    this.model = model;
    this.levels = levelsOf(model);
    this.tube = tubeOf(model, course);
    this.passage = new Passage(model.id, this.tube);
  }

  /**
   * Loads the cuts at the places of a view, and the report; failed requests are repeated when the
   * service is available again.
   *
   * The surface is loaded later, when a picture can show it.
   */
  start(view: View): void {
    const follow = [effect(() => this.#wantCut(view)), effect(() => this.#wantSimulated(view))];
    void this.loadReport();
    const repeat = reconnections.subscribe(() => {
      if (this.surfaceFault.peek()) void this.retrySurface();
      void this.passage.again();
      if (this.placesFault.peek() !== undefined) void this.loadPlaces();
      if (this.reportFault.peek() !== undefined) void this.loadReport();
      this.cuts.again();
      this.simulated.again();
      this.pictures.again();
    });
    this.#leave = () => {
      for (const end of follow) end();
      repeat();
    };
  }

  /** Position along the tube of the cut at a place, micrometres; `place` is a fraction. */
  planeOf(place: number): number {
    const { begin, length } = this.tube;
    const z_um = planeAt((begin + place * length) * 1000, begin * 1000, (begin + length) * 1000);
    return Math.round(z_um * 1e4) / 1e4;
  }

  /** Index of the section that is nearest to a place; undefined while the places are unknown. */
  indexAt(place: number): number | undefined {
    const known = this.fractions.value;
    return known.length > 0 ? nearestIndex(known, place) : undefined;
  }

  /** The reason why there is no cut at a position; undefined if there is one or it is awaited. */
  lackAt(z_um: number): Lack | undefined {
    if (this.uncut.value !== undefined) return { why: this.uncut.value, fault: false };
    const outcome = this.cuts.outcome.value;
    if (outcome?.key !== String(z_um)) return undefined;
    const { value, fault } = outcome;
    if (!value) return { why: explain(fault), fault: true };
    return value.cut ? undefined : { why: value.why, fault: false };
  }

  /** Requests the simulated section next to a place without a cut; subscribes the calling effect. */
  #wantSimulated(view: View): void {
    const place = view.section.value;
    const index = this.indexAt(place);
    if (index === undefined || !this.lackAt(this.planeOf(place))) return;
    untracked(() => {
      this.simulated.want(String(index), async (signal) => {
        return ofSection(await ask((service) => service.section(this.model.id, index, { signal })));
      });
    });
  }

  /** Requests the cut at the place of a view; subscribes the calling effect. */
  #wantCut(view: View): void {
    const z_um = this.planeOf(view.section.value);
    if (this.uncut.value !== undefined) return;
    // A flight waits for each cut; a request for every place would abort all requests before it.
    if (view.flying.value && this.cuts.awaited.value !== undefined) return;
    untracked(() => {
      this.cuts.want(String(z_um), async (signal) => {
        const answer = await answered(ask((service) => service.cut(this.model.id, { z_um }, { signal })));
        if (answer.cut === undefined && answer.ever) this.uncut.value = answer.why;
        return answer;
      });
    });
  }

  /** Removes the obstacle of the flight, if it can be removed. */
  async removeObstacle(): Promise<void> {
    if (this.passage.obstacle.peek()) await this.passage.load();
    else if (this.surfaceFault.peek()) await this.retrySurface();
  }

  /** Loads the coarsest level of detail, then finer ones as far as the device can show them. */
  async loadSurface(): Promise<void> {
    const present = device();
    if (!present) return;
    await this.#loadLevels(this.levels.slice(0, automaticLevel(this.levels, present) + 1));
  }

  /** Coarsest level of detail with which the flight is possible. */
  get #flightLevel(): Level | undefined {
    return this.levels[Math.min(FLIGHT_LEVEL, this.levels.length - 1)];
  }

  /** True if a level of detail is too coarse for the flight. */
  isTooCoarse(level: Level): boolean {
    return this.levels.indexOf(level) < this.levels.indexOf(this.#flightLevel!);
  }

  /** Loads a level of detail with which the flight is possible, unless one is shown or planned. */
  loadFlightLevel(): void {
    const level = this.level.peek();
    if (!level || [level, ...this.#planned].some((one) => !this.isTooCoarse(one))) return;
    void this.#loadLevels([this.#flightLevel!]);
  }

  /** Replaces the current level of detail by another one. */
  loadLevel(level: Level): Promise<void> {
    return this.#loadLevels([level]);
  }

  /** Loads the levels of detail that a failure left. */
  retrySurface(): Promise<void> {
    return this.#loadLevels(this.surfaceFault.peek()?.left ?? []);
  }

  /** Loads levels of detail one after the other. Another call ends this one. */
  async #loadLevels(levels: readonly Level[]): Promise<void> {
    this.#surfaceLoad.abort();
    this.#surfaceLoad = new AbortController();
    const signal = AbortSignal.any([this.#surfaceLoad.signal, this.#abort.signal]);
    this.surfaceFault.value = undefined;
    for (const [k, level] of levels.entries()) {
      this.#planned = levels.slice(k);
      try {
        await this.#load(level, signal);
      } catch (error) {
        if (signal.aborted) return;
        batch(() => {
          this.surfaceFault.value = { reason: explain(error), left: levels.slice(k) };
          this.loading.value = undefined;
        });
        break;
      }
    }
    if (!signal.aborted) this.#planned = [];
  }

  async #load(level: Level, signal: AbortSignal): Promise<void> {
    const onProgress = (received: number) => {
      if (!signal.aborted) this.loading.value = { level, received };
    };
    onProgress(0);
    const file = await ask((service) => service.bytes(this.model.id, level.file.name, { onProgress, signal }));
    const { begin, course } = this.tube;
    // Along a course, the positions of a piece do not refer to an axis.
    const surface = await readSurface(file, course ? 0 : begin, course);
    signal.throwIfAborted();
    batch(() => {
      this.surface.value = surface;
      this.level.value = level;
      this.loading.value = undefined;
    });
  }

  /** Reads the places of all sections from their file. */
  async loadPlaces(): Promise<void> {
    const { signal } = this.#abort;
    this.placesFault.value = undefined;
    try {
      this.places.value = placesIn(await ask((service) => service.sections(this.model.id, { signal })));
    } catch (error) {
      if (!signal.aborted) this.placesFault.value = explain(error);
    }
  }

  async loadReport(): Promise<void> {
    const { signal } = this.#abort;
    this.reportFault.value = undefined;
    try {
      const report = await ask((service) => service.report(this.model.id, { signal }));
      batch(() => {
        this.report.value = report;
        this.places.value = placesOf(report);
      });
      if (!this.places.peek()) void this.loadPlaces();
    } catch (error) {
      if (!signal.aborted) this.reportFault.value = explain(error);
    }
  }

  dispose(): void {
    this.#leave();
    this.#abort.abort();
    this.passage.dispose();
    this.cuts.dispose();
    this.simulated.dispose();
    this.pictures.dispose();
  }
}

/** Factor by which a bent tube may be wider than at the sides of its bounding box. */
const ELSEWHERE = 1.15;

function tubeOf({ summary }: Model, course: Course | undefined): Tube {
  const bounds = summary?.certificate?.bounds_um;
  if (!bounds) throw new Error("The model has no certificate.");
  const [low, high] = bounds;
  if (course) {
    // Lower bounds of the distance between walls and centre line.
    const beyond = [0, 1, 2].flatMap((axis) => [high[axis]! / 1000 - course.high[axis]!, course.low[axis]! - low[axis]! / 1000]);
    return { x: 0, y: 0, radius: ELSEWHERE * Math.max(...beyond), begin: course.begin, length: course.length, course };
  }
  const middle = (axis: 0 | 1) => (low[axis] + high[axis]) / 2000;
  return {
    x: middle(0),
    y: middle(1),
    radius: Math.max(high[0] - low[0], high[1] - low[1]) / 2000,
    begin: low[2] / 1000,
    length: (high[2] - low[2]) / 1000,
  };
}
