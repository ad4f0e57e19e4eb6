// What is loaded of one model that is explored: levels of detail, sections, and what is computed from them.
import { batch, computed, signal } from "@preact/signals";
import type { Model, Report, Sections } from "oviduct-client";
import { ask, explain } from "../service.ts";
import { reconnections } from "../stream.ts";
import type { Course } from "./course.ts";
import type { Answer } from "./cuts.ts";
import type { Tube } from "./framing.ts";
import { Latest } from "./latest.ts";
import { Measurement } from "./measure.ts";
import type { Picture } from "./slides.ts";
import { survey, type Survey } from "./survey.ts";
import { device } from "./viewer/device.ts";
import { automaticLevel, levelsOf, type Level } from "./viewer/levels.ts";
import { readSurface, type Surface } from "./viewer/surface.ts";

export class Exploration {
  readonly model: Model;
  readonly tube: Tube;
  readonly levels: readonly Level[];
  readonly surface = signal<Surface | undefined>(undefined);
  /** Level that `surface` is of. */
  readonly level = signal<Level | undefined>(undefined);
  /** The level that is being loaded, and how many of its bytes have come. */
  readonly loading = signal<{ level: Level; received: number } | undefined>(undefined);
  /** Why a level did not come, and what is left to load: that level, then those that were to follow. */
  readonly surfaceFault = signal<{ reason: string; left: readonly Level[] } | undefined>(undefined);
  readonly sections = signal<Sections | undefined>(undefined);
  readonly sectionsFault = signal<string | undefined>(undefined);
  /** Planar cuts by the index of the section in whose place they are. */
  readonly cuts = new Latest<Answer>(120, 30);
  /** Why no plane can cut the surface. */
  readonly uncut = signal<string | undefined>(undefined);
  /** Pictures of cross sections. */
  readonly pictures = new Latest<Picture>(200, 8, ({ url }) => URL.revokeObjectURL(url));
  readonly survey = signal<Survey | undefined>(undefined);
  readonly report = signal<Report | undefined>(undefined);
  readonly reportFault = signal<string | undefined>(undefined);
  readonly measurement = new Measurement();
  /** Sections by their fraction of the tube's length. */
  readonly fractions = computed(() => this.sections.value?.entries.map(({ z_um }) => (z_um / 1000 - this.tube.begin) / this.tube.length) ?? []);
  readonly #abort = new AbortController();
  #surfaceLoad = new AbortController();
  #leave = () => {};

  /** Bent models need their course. */
  constructor(model: Model, course?: Course) {
    this.model = model;
    this.levels = levelsOf(model);
    this.tube = tubeOf(model, course);
  }

  /** Loads sections and report; the surface is loaded once a picture can show it. What fails is repeated when the service is back. */
  start(): void {
    void this.loadSections();
    void this.loadReport();
    this.#leave = reconnections.subscribe(() => {
      if (this.surfaceFault.peek()) void this.retrySurface();
      if (this.sectionsFault.peek() !== undefined) void this.loadSections();
      if (this.reportFault.peek() !== undefined) void this.loadReport();
      this.cuts.again();
      this.pictures.again();
    });
  }

  /** Loads the lightest level, then better ones as far as the device is fit for them. */
  async loadSurface(): Promise<void> {
    const present = device();
    if (!present) return;
    await this.#loadLevels(this.levels.slice(0, automaticLevel(this.levels, present) + 1));
  }

  /** Loads a level in place of the present one. */
  loadLevel(level: Level): Promise<void> {
    return this.#loadLevels([level]);
  }

  /** Loads what a fault has left. */
  retrySurface(): Promise<void> {
    return this.#loadLevels(this.surfaceFault.peek()?.left ?? []);
  }

  /** Loads levels in turn, each in place of the one before. Another call ends this one. */
  async #loadLevels(levels: readonly Level[]): Promise<void> {
    this.#surfaceLoad.abort();
    this.#surfaceLoad = new AbortController();
    const signal = AbortSignal.any([this.#surfaceLoad.signal, this.#abort.signal]);
    this.surfaceFault.value = undefined;
    for (const [k, level] of levels.entries()) {
      try {
        await this.#load(level, signal);
      } catch (error) {
        if (signal.aborted) return;
        batch(() => {
          this.surfaceFault.value = { reason: explain(error), left: levels.slice(k) };
          this.loading.value = undefined;
        });
        return;
      }
    }
  }

  async #load(level: Level, signal: AbortSignal): Promise<void> {
    const onProgress = (received: number) => {
      if (!signal.aborted) this.loading.value = { level, received };
    };
    onProgress(0);
    const file = await ask((service) => service.bytes(this.model.id, level.file.name, { onProgress, signal }));
    const { begin, course } = this.tube;
    // Along a course, places of a piece are not those of an axis.
    const surface = await readSurface(file, course ? 0 : begin, course);
    signal.throwIfAborted();
    batch(() => {
      this.surface.value = surface;
      this.level.value = level;
      this.loading.value = undefined;
    });
  }

  async loadSections(): Promise<void> {
    const { signal } = this.#abort;
    this.sectionsFault.value = undefined;
    try {
      const sections = await ask((service) => service.sections(this.model.id, { signal }));
      signal.throwIfAborted();
      this.sections.value = sections;
      this.survey.value = await survey(sections, this.tube.begin, signal);
    } catch (error) {
      if (!signal.aborted) this.sectionsFault.value = explain(error);
    }
  }

  async loadReport(): Promise<void> {
    const { signal } = this.#abort;
    this.reportFault.value = undefined;
    try {
      this.report.value = await ask((service) => service.report(this.model.id, { signal }));
    } catch (error) {
      if (!signal.aborted) this.reportFault.value = explain(error);
    }
  }

  dispose(): void {
    this.#leave();
    this.#abort.abort();
    this.cuts.dispose();
    this.pictures.dispose();
  }
}

/** How much wider a bent tube may be where it is not at the sides of its box. */
const ELSEWHERE = 1.15;

function tubeOf({ summary }: Model, course: Course | undefined): Tube {
  const bounds = summary?.certificate?.bounds_um;
  if (!bounds) throw new Error("The model has no certificate.");
  const [low, high] = bounds;
  if (course) {
    // The walls are at least so far from the centre line.
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
