// One study: its progress, its parameters, and its models as a table and a plot.
import { useState } from "preact/hooks";
import { OviductError, type Batch, type Oviduct, type Table } from "oviduct-client";
import { WorkersNotice } from "../growing/workers.tsx";
import { attempt } from "../model/actions.tsx";
import { Confirm } from "../model/confirm.tsx";
import { forget } from "../models.ts";
import { go, href, link } from "../router.ts";
import { ask, explain } from "../service.ts";
import { short } from "../ui/format.ts";
import { Ago, CopyButton, Icon, Notice, toast } from "../ui/widgets.tsx";
import { columns, text, type Cell, type Column, type Schema } from "./columns.ts";
import { batchTitle, Counts, isOpen } from "./counts.tsx";
import { Plot } from "./plot.tsx";
import { useReading } from "./reading.ts";
import { Models } from "./table.tsx";

interface Read {
  batch: Batch;
  table: Table;
  schema: Schema | undefined;
}

async function read(id: string, signal: AbortSignal): Promise<Read> {
  const [batch, table, schema] = await Promise.all([
    ask((service) => service.getBatch(id, { signal })),
    ask((service) => service.table(id, { signal })),
    // Without the names of parameters, the page is still useful.
    ask((service) => service.schema({ signal })).catch(() => undefined),
  ]);
  return { batch, table, schema };
}

export function Study({ id }: { id: string }) {
  const { value, fault, again } = useReading(id, (signal) => read(id, signal));
  if (fault instanceof OviductError && fault.is("batch-not-found")) {
    return (
      <Notice title="There is no such study">
        <p>It never existed, or it was deleted.</p>
        <p><a href={href(["batches"])}>Go to the studies</a></p>
      </Notice>
    );
  }
  if (!value) {
    if (fault === undefined) return <p class="soft" aria-busy="true">Loading …</p>;
    return (
      <Notice title="The study could not be read" kind="error">
        <p>{explain(fault)}</p>
        <p class="row"><button type="button" class="button button-primary" onClick={again}>Try again</button></p>
      </Notice>
    );
  }
  const { batch, table, schema } = value;
  const { seed, varied, figures } = columns(table, schema);
  return (
    <div class="study">
      <Head batch={batch} onChange={again} />
      {batch.counts.queued > 0 && <WorkersNotice />}
      <section class="card" aria-label="Progress"><Counts counts={batch.counts} /></section>
      {varied.length > 0 && <Varied varied={varied} table={table} />}
      <Plot table={table} xs={[...varied, seed, ...figures]} ys={figures} />
      <Models table={table} columns={[seed, ...varied, ...figures]} />
    </div>
  );
}

function Head({ batch, onChange }: { batch: Batch; onChange: () => void }) {
  const [asking, setAsking] = useState<"cancel" | "delete">();
  const { id } = batch;
  const cancel = () => attempt(() => ask((service) => service.cancelBatch(id))).then(onChange);
  const remove = () =>
    attempt(async () => {
      await ask((service) => service.deleteBatch(id));
      batch.models?.forEach(forget);
      go(["batches"]);
      toast("The study was deleted.");
    });
  return (
    <div class="page-head">
      <div>
        <h1>{batchTitle(batch)}</h1>
        <p class="small soft"><Ago time={batch.created_at} />{batch.owner && `, by ${batch.owner}`}</p>
      </div>
      <div class="actions">
        <Download text="Table (CSV)" url={(service) => service.tableUrl(id)} />
        <Download text="All files (ZIP)" url={(service) => service.archiveUrl(id)} />
        {isOpen(batch) && <button type="button" class="button" onClick={() => setAsking("cancel")}><Icon name="stop" /> Cancel</button>}
        <button type="button" class="button button-danger" onClick={() => setAsking("delete")}><Icon name="trash" /> Delete</button>
        <a class="button" href={href([], { batch: id })}>Show as a list</a>
        <CopyButton label="Copy link" text={link} />
      </div>
      {asking === "cancel" && (
        <Confirm title="Cancel this study?" action="Cancel the study" onConfirm={cancel} onClose={() => setAsking(undefined)}>
          <p>Models that have not ended, {batch.counts.queued + batch.counts.running} of {batch.counts.total}, will have no files. The others stay.</p>
        </Confirm>
      )}
      {asking === "delete" && (
        <Confirm title="Delete this study?" action="Delete the study" onConfirm={remove} onClose={() => setAsking(undefined)}>
          <p>All {batch.counts.total} models are removed with their files. This cannot be undone.</p>
        </Confirm>
      )}
    </div>
  );
}

function Download({ text, url }: { text: string; url: (service: Oviduct) => Promise<string> }) {
  const download = () =>
    attempt(async () => {
      // With an API key, the URL contains a ticket for one download within a minute.
      const link = document.createElement("a");
      link.href = await ask(url);
      link.download = "";
      link.click();
    });
  return <button type="button" class="button" onClick={download}><Icon name="download" /> {text}</button>;
}

function Varied({ varied, table }: { varied: Column[]; table: Table }) {
  return (
    <section class="card" aria-label="Varied parameters">
      <h2>What was varied</h2>
      <dl class="study-varied num">
        {varied.map(({ key, at, title, unit }) => (
          <div key={key}><dt>{title}</dt><dd>{values(table.rows.map((row) => row[at]))}{unit && ` ${unit}`}</dd></div>
        ))}
      </dl>
    </section>
  );
}

/** Maximum number of values that are listed; more values are shown as a range. */
const LISTED = 6;

function values(cells: (Cell | undefined)[]): string {
  const distinct = [...new Map(cells.map((cell) => [text(cell), cell ?? null])).values()];
  const numbers = distinct.filter((cell) => typeof cell === "number").sort((a, b) => a - b);
  if (numbers.length < distinct.length) return distinct.map((cell) => (cell === null ? "as the preset" : text(cell))).join(", ");
  if (numbers.length <= LISTED) return numbers.map(short).join(", ");
  return `${short(numbers[0]!)} to ${short(numbers.at(-1)!)}, ${numbers.length} values`;
}
