// What is loaded of one model that is explored: levels of detail, sections, and what is computed from them.
import { batch, computed, signal } from "@preact/signals";
import type { Model, Report, Sections } from "oviduct-client";
import { ask, explain } from "../service.ts";
import type { Tube } from "./framing.ts";
import { Measurement } from "./measure.ts";
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
  readonly surfaceFault = signal<string | undefined>(undefined);
  readonly sections = signal<Sections | undefined>(undefined);
  readonly sectionsFault = signal<string | undefined>(undefined);
  readonly survey = signal<Survey | undefined>(undefined);
  readonly report = signal<Report | undefined>(undefined);
  readonly reportFault = signal<string | undefined>(undefined);
  readonly measurement = new Measurement();
  /** Sections by their fraction of the tube's length. */
  readonly fractions = computed(() => this.sections.value?.entries.map(({ z_um }) => z_um / 1000 / this.tube.length) ?? []);
  readonly #abort = new AbortController();
  #surfaceLoad = new AbortController();

  constructor(model: Model) {
    this.model = model;
    this.levels = levelsOf(model);
    this.tube = tubeOf(model);
  }

  /** Loads sections and report; the surface is loaded once a picture can show it. */
  start(): void {
    void this.loadSections();
    void this.loadReport();
  }

  /** Loads the lightest level, then better ones as far as the device is fit for them. */
  async loadSurface(): Promise<void> {
    const present = device();
    if (!present) return;
    const last = automaticLevel(this.levels, present);
    for (const level of this.levels.slice(0, last + 1)) {
      if (!(await this.loadLevel(level))) return;
    }
  }

  /** Loads a level in place of the present one; whether it came. Another call ends this one. */
  async loadLevel(level: Level): Promise<boolean> {
    this.#surfaceLoad.abort();
    this.#surfaceLoad = new AbortController();
    const signal = AbortSignal.any([this.#surfaceLoad.signal, this.#abort.signal]);
    batch(() => {
      this.surfaceFault.value = undefined;
      this.loading.value = { level, received: 0 };
    });
    try {
      const onProgress = (received: number) => {
        if (!signal.aborted) this.loading.value = { level, received };
      };
      const surface = await readSurface(await ask((service) => service.bytes(this.model.id, level.file.name, { onProgress, signal })));
      signal.throwIfAborted();
      batch(() => {
        this.surface.value = surface;
        this.level.value = level;
        this.loading.value = undefined;
      });
      return true;
    } catch (error) {
      if (!signal.aborted) {
        batch(() => {
          this.surfaceFault.value = explain(error);
          this.loading.value = undefined;
        });
      }
      return false;
    }
  }

  async loadSections(): Promise<void> {
    const { signal } = this.#abort;
    this.sectionsFault.value = undefined;
    try {
      const sections = await ask((service) => service.sections(this.model.id, { signal }));
      signal.throwIfAborted();
      this.sections.value = sections;
      this.survey.value = await survey(sections, signal);
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
    this.#abort.abort();
  }
}

function tubeOf({ summary }: Model): Tube {
  const bounds = summary?.certificate?.bounds_um;
  if (!bounds) throw new Error("The model has no certificate.");
  const [low, high] = bounds;
  const middle = (axis: 0 | 1) => (low[axis] + high[axis]) / 2000;
  return {
    x: middle(0),
    y: middle(1),
    radius: Math.max(high[0] - low[0], high[1] - low[1]) / 2000,
    length: high[2] / 1000,
  };
}
