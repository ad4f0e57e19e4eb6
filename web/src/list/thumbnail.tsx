// A small picture of a model: its ampulla end, or its newest section while it grows.
import { useEffect, useRef, useState } from "preact/hooks";
import type { ModelState } from "oviduct-client";
import { thinned } from "../growing/contours.ts";
import { SectionDrawing } from "../growing/section.tsx";
import { sections } from "../models.ts";
import { picture } from "../pictures.ts";

/** Longest side in pixels, twice that of the frame for dense screens. */
const SIZE = 176;
/** Milliseconds in view after which the picture is requested. */
const PAUSE = 150;
/** Maximum number of points per contour in a thumbnail. */
const POINTS = 400;

export function Thumbnail({ model }: { model: ModelState }) {
  const { id, status } = model;
  const live = sections(id).value.at(-1);
  const frame = useRef<HTMLDivElement>(null);
  const [url, setUrl] = useState<string>();
  const succeeded = status === "succeeded";
  useEffect(() => {
    if (!succeeded) return;
    let left = false;
    let timer: ReturnType<typeof setTimeout> | undefined;
    const ask = () => {
      watcher.disconnect();
      picture(id, "ampulla", SIZE).then(
        (url) => left || setUrl(url),
        // The placeholder stays.
        () => {},
      );
    };
    // Rows that are scrolled past request no picture.
    const watcher = new IntersectionObserver((entries) => {
      clearTimeout(timer);
      if (entries.at(-1)?.isIntersecting) timer = setTimeout(ask, PAUSE);
    });
    watcher.observe(frame.current!);
    return () => {
      left = true;
      clearTimeout(timer);
      watcher.disconnect();
    };
  }, [id, succeeded]);
  return (
    <div ref={frame} class="thumbnail">
      {url ? <img src={url} alt="" /> : live?.inner ? <SectionDrawing inner={thinned(live.inner, POINTS)} outer={thinned(live.outer, POINTS)} /> : <Placeholder />}
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
