// Studies: models that were requested together.
import { useState } from "preact/hooks";
import type { Batch } from "oviduct-client";
import { href, route } from "../router.ts";
import { ask, explain } from "../service.ts";
import { Ago, Icon, Notice } from "../ui/widgets.tsx";
import { batchTitle, Counts } from "./counts.tsx";
import { useReading } from "./reading.ts";
import { Study } from "./study.tsx";
import "./batches.css";

const PAGE = 20;
const LARGEST_PAGE = 100;

export default function BatchesPage() {
  const [id] = useState(() => route.peek().path[1]);
  return id === undefined ? <Studies /> : <Study id={id} />;
}

function Studies() {
  const [shown, setShown] = useState(PAGE);
  const { value, fault, again } = useReading(String(shown), (signal) => newest(shown, signal));
  const [before, setBefore] = useState(value);
  // The list stays visible while more of it is loading.
  if (value && value !== before) setBefore(value);
  const present = value ?? before;
  return (
    <>
      <div class="page-head">
        <h1>Studies</h1>
        <div class="actions">
          <a class="button button-primary" href={href(["new"], { purpose: "study" })}><Icon name="plus" /> New study</a>
        </div>
      </div>
      {fault !== undefined && (
        <Notice title="The studies could not be read" kind="error">
          <p>{explain(fault)}</p>
          <p class="row"><button type="button" class="button button-primary" onClick={again}>Try again</button></p>
        </Notice>
      )}
      {!present && fault === undefined && <p class="soft" aria-busy="true">Loading …</p>}
      {present?.batches.length === 0 && (
        <Notice title="There is no study yet">
          <p>A study grows many models at once: several seeds, or several values of a parameter, to see what it changes.</p>
        </Notice>
      )}
      <ul class="studies">
        {present?.batches.map((batch) => (
          <li key={batch.id} class="card">
            <div>
              <h2><a href={href(["batches", batch.id])}>{batchTitle(batch)}</a></h2>
              <p class="small soft"><Ago time={batch.created_at} />{batch.owner && `, by ${batch.owner}`}</p>
            </div>
            <Counts counts={batch.counts} />
          </li>
        ))}
      </ul>
      {present?.more && <p class="row studies-more"><button type="button" class="button" onClick={() => setShown(shown + PAGE)}>Show older studies</button></p>}
    </>
  );
}

async function newest(count: number, signal: AbortSignal): Promise<{ batches: Batch[]; more: boolean }> {
  const batches: Batch[] = [];
  let cursor: string | undefined;
  do {
    const pageSize = Math.min(LARGEST_PAGE, count - batches.length);
    const page = await ask((service) => service.listBatchesPage({}, { pageSize, cursor, signal }));
    batches.push(...page.batches);
    cursor = page.next ?? undefined;
  } while (cursor !== undefined && batches.length < count);
  return { batches, more: cursor !== undefined };
}
