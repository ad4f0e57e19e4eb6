// Loads the courses of bent models before they are explored. Straight models need none.
import type { Model } from "oviduct-client";
import type { VNode } from "preact";
import { useEffect, useState } from "preact/hooks";
import { ask, explain } from "../service.ts";
import { reconnections } from "../stream.ts";
import { Notice } from "../ui/widgets.tsx";
import { Course, isBent } from "./course.ts";

/**
 * The course of each model (undefined for a straight one), or the content to show while loading.
 */
type Loaded = { courses: readonly (Course | undefined)[]; instead?: undefined } | { courses?: undefined; instead: VNode };

export function useCourses(models: readonly Model[]): Loaded {
  const [courses, setCourses] = useState<readonly (Course | undefined)[] | undefined>(() => (models.some(isBent) ? undefined : models.map(() => undefined)));
  const [fault, setFault] = useState<string>();
  const [attempts, setAttempts] = useState(0);
  useEffect(() => {
    if (courses) return;
    const abort = new AbortController();
    const load = async (model: Model) => (isBent(model) ? new Course(await ask((service) => service.course(model.id, { signal: abort.signal }))) : undefined);
    Promise.all(models.map(load)).then(setCourses, (error: unknown) => abort.signal.aborted || setFault(explain(error)));
    return () => abort.abort();
  }, [reconnections.value, attempts]);
  if (courses) return { courses };
  if (fault === undefined) return { instead: <p class="soft" aria-busy="true">Loading the centre line …</p> };
  return {
    instead: (
      <Notice title="The centre line could not be loaded" kind="error">
        <p>{fault}</p>
        <button type="button" class="button" onClick={() => (setFault(undefined), setAttempts(attempts + 1))}>Try again</button>
      </Notice>
    ),
  };
}
