// A failed or cancelled model.
import type { ModelState } from "oviduct-client";
import { SectionDrawing } from "../growing/section.tsx";
import { sections } from "../models.ts";
import { short } from "../ui/format.ts";
import { Notice } from "../ui/widgets.tsx";

/** Meanings of common problems for the user. Other problems are shown with the service's text. */
const MEANINGS: Record<string, string> = {
  certificate: "The surface did not pass its tests, so there are no files. Another seed, or weaker growth, may pass.",
  panic: "The program itself failed. That is a fault of oviduct: whoever runs the service finds the details in its log.",
  memory: "The model needs more memory than the worker has. Fewer particles or sections need less.",
  "attempts-exhausted": "Workers stopped while they grew it, again and again.",
  timeout: "It needed more time than a worker may spend on one model. Fewer steps or particles need less.",
  storage: "The files could not be stored. A retry may succeed once there is room.",
};

export function Ended({ model }: { model: ModelState }) {
  const { problem, progress } = model;
  const last = sections(model.id).value.at(-1);
  const meaning = problem && MEANINGS[problem.type.slice(problem.type.lastIndexOf(":") + 1)];
  return (
    <div class="growing">
      {model.status === "failed" ? (
        <Notice title={problem?.title ?? "The model has failed"} kind="error">
          {meaning && <p>{meaning}</p>}
          {problem && <p class="soft">{problem.detail}</p>}
          <p>“Retry” grows it again with the same seed, as a new model.</p>
        </Notice>
      ) : (
        <Notice title="The model was cancelled">
          <p>
            {progress ? `It had reached step ${short(progress.step)} of ${short(progress.steps)}.` : "It had not started."} It has no
            files. “Grow again” repeats the request.
          </p>
        </Notice>
      )}
      {last?.inner && (
        <figure class="card model-last">
          <SectionDrawing inner={last.inner} outer={last.outer} scaleBar label="The last section that was seen" />
          <figcaption class="small soft">The last section that was seen, {(last.z_um / 1000).toFixed(1)} mm from the isthmus</figcaption>
        </figure>
      )}
    </div>
  );
}
