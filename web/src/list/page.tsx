// The models of the service, newest first.
import { useCallback, useRef, useState } from "preact/hooks";
import { WorkersNotice } from "../growing/workers.tsx";
import { href, route } from "../router.ts";
import { Icon, Notice } from "../ui/widgets.tsx";
import { AllMatching, Selection } from "./bulk.tsx";
import { isEmpty, readFilter } from "./filter.ts";
import { Filters } from "./filters.tsx";
import { useKeptFocus } from "./focus.ts";
import { useListing } from "./listing.ts";
import { Row } from "./row.tsx";
import { twins } from "./twins.ts";
import { Welcome } from "./welcome.tsx";
import "./list.css";

export function Models() {
  const filter = readFilter(route.value.query);
  const { which, models, more, reading, fault, retry } = useListing(filter);
  const [selected, setSelected] = useState<ReadonlySet<string>>(new Set());
  const [bulk, setBulk] = useState<"cancel" | "delete">();
  const chosen = models?.filter(({ id }) => selected.has(id)) ?? [];
  const select = useCallback((id: string, on: boolean) => {
    setSelected((before) => {
      const next = new Set(before);
      if (on) next.add(id);
      else next.delete(id);
      return next;
    });
  }, []);
  const [heading, list] = [useRef<HTMLHeadingElement>(null), useRef<HTMLUListElement>(null)];
  const noteFocus = useKeptFocus(heading, list);
  const alike = twins(models ?? []);
  const newcomer = models?.length === 0 && isEmpty(filter);
  return (
    <div onFocusIn={noteFocus}>
      <div class="page-head">
        <h1 ref={heading} tabIndex={-1}>Models</h1>
        {!newcomer && (
          <div class="actions">
            <a class="button button-primary" href={href(["new"], { purpose: "model" })}><Icon name="plus" /> New model</a>
          </div>
        )}
      </div>
      {models?.some(({ status }) => status === "queued") && <WorkersNotice />}
      {newcomer ? <><WorkersNotice /><Welcome /></> : <Filters filter={filter} />}
      {fault && (
        <Notice title="The models could not be read" kind="error">
          <p>{fault}</p>
          <p class="row"><button type="button" class="button button-primary" onClick={retry}>Try again</button></p>
        </Notice>
      )}
      {models?.length === 0 && !newcomer && <p class="soft models-none">No model matches the filter.</p>}
      {chosen.length > 0 && <Selection models={chosen} onSelect={(ids) => setSelected(new Set(ids))} />}
      <ul ref={list} class="models" aria-busy={reading}>
        {models?.map(({ id }) => <Row key={id} id={id} selected={selected.has(id)} twin={alike.has(id)} onSelect={select} />)}
      </ul>
      {!models && reading && <p class="soft">Loading …</p>}
      {models && models.length > 0 && (
        <div class="models-foot">
          {more && <button type="button" class="button" disabled={reading} onClick={more}>Show older models</button>}
          <span class="models-all">
            <button type="button" class="button" onClick={() => setSelected(new Set(models.map(({ id }) => id)))}>Select all shown</button>
            <button type="button" class="button" onClick={() => setBulk("cancel")}>Cancel all {isEmpty(filter) ? "" : "that match"} …</button>
            <button type="button" class="button button-danger" onClick={() => setBulk("delete")}>Delete all {isEmpty(filter) ? "" : "that match"} …</button>
          </span>
        </div>
      )}
      {bulk && <AllMatching which={which} deed={bulk} onClose={() => setBulk(undefined)} />}
    </div>
  );
}
