// A small picture of a model: a section of its ampulla; while it grows, the newest one.
import { useEffect, useRef, useState } from "preact/hooks";
import type { ModelState } from "oviduct-client";
import { thinned } from "../growing/contours.ts";
import { SectionDrawing, type Drawn } from "../growing/section.tsx";
import { sections, type Contour } from "../models.ts";
import { ask } from "../service.ts";

/** Where the picture is cut, from the isthmus: folds are high and branched there. */
const PLACE = 0.8;
/** Points of a contour that a thumbnail shows. */
const POINTS = 400;
/** Thumbnails that are kept. */
const KEPT = 300;
const drawings = new Map<string, Promise<Drawn>>();

export function Thumbnail({ model }: { model: ModelState }) {
  const { id, status, summary } = model;
  const live = sections(id).value.at(-1);
  const frame = useRef<HTMLDivElement>(null);
  const [drawn, setDrawn] = useState<Drawn>();
  const succeeded = status === "succeeded";
  useEffect(() => {
    if (!succeeded) return;
    let left = false;
    // Those that are scrolled past are not read.
    const watcher = new IntersectionObserver(([entry]) => {
      if (!entry?.isIntersecting) return;
      watcher.disconnect();
      drawing(id, Math.floor(PLACE * ((summary?.sections ?? 1) - 1))).then(
        (drawn) => left || setDrawn(drawn),
        // The placeholder stays.
        () => {},
      );
    });
    watcher.observe(frame.current!);
    return () => {
      left = true;
      watcher.disconnect();
    };
  }, [id, succeeded]);
  const shown = drawn ?? live;
  return (
    <div ref={frame} class="thumbnail">
      {shown ? <SectionDrawing inner={thinned(shown.inner, POINTS)} outer={thinned(shown.outer, POINTS)} /> : <Placeholder />}
    </div>
  );
}

function Placeholder() {
  return (
    <svg class="thumbnail-empty" viewBox="-50 -50 100 100" aria-hidden="true">
      <circle r="40" />
      <circle r="22" />
    </svg>
  );
}

function drawing(id: string, index: number): Promise<Drawn> {
  let known = drawings.get(id);
  if (!known) {
    known = ask((service) => service.section(id, index)).then(({ inner, outer }) => ({
      inner: contour(inner.points),
      outer: contour(outer.points),
    }));
    known.catch(() => drawings.delete(id));
    drawings.set(id, known);
    const [oldest] = drawings.keys();
    if (drawings.size > KEPT) drawings.delete(oldest!);
  }
  return known;
}

function contour(points: readonly (readonly number[])[]): Contour {
  return thinned(Float32Array.from(points.flat()), POINTS);
}
