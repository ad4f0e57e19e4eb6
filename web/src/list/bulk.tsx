// Actions on several models.
import { useEffect, useState } from "preact/hooks";
import type { ModelFilter, ModelState, Operation, Which } from "oviduct-client";
import { hasEnded } from "../growing/words.ts";
import { attempt, cancel, remove } from "../model/actions.tsx";
import { Confirm } from "../model/confirm.tsx";
import { href } from "../router.ts";
import { ask, explain } from "../service.ts";
import { Icon, toast } from "../ui/widgets.tsx";
import { hasConditions } from "./filter.ts";
import { settle } from "./settle.ts";

type Deed = "cancel" | "delete";

interface SelectionProps {
  models: ModelState[];
  /** Called with the ids of the new selection. */
  onSelect: (ids: string[]) => void;
}

/** Shown while models are selected. */
export function Selection({ models, onSelect }: SelectionProps) {
  const [asking, setAsking] = useState<Deed>();
  const open = models.filter((model) => !hasEnded(model));
  const [a, b] = models;
  const comparable = models.length === 2 && models.every(({ status }) => status === "succeeded");
  const doAll = async (deed: Deed) => {
    const meant = deed === "cancel" ? open : models;
    const failed = await settle(meant, ({ id }) => (deed === "cancel" ? cancel(id) : remove(id)));
    const done = `${meant.length - failed.length} of ${counted(meant.length)} ${deed === "cancel" ? "cancelled" : "deleted"}`;
    if (failed.length > 0) toast(`${done}; ${failed.length} failed: ${explain(failed[0]!.error)}`, "error");
    onSelect(failed.map(({ one }) => one.id));
  };
  const count = asking === "cancel" ? open.length : models.length;
  return (
    <div class="selection card" role="region" aria-label="Selected models">
      <strong role="status">{models.length} selected</strong>
      {comparable ? (
        <a class="button" href={href(["compare", a!.id, b!.id])}><Icon name="compare" /> Compare</a>
      ) : (
        <button type="button" class="button" disabled title="Select two models that have succeeded"><Icon name="compare" /> Compare</button>
      )}
      <button type="button" class="button" disabled={open.length === 0} onClick={() => setAsking("cancel")}><Icon name="stop" /> Cancel</button>
      <button type="button" class="button button-danger" onClick={() => setAsking("delete")}><Icon name="trash" /> Delete</button>
      <button type="button" class="button" onClick={() => onSelect([])}>Clear</button>
      {asking && (
        <Confirm
          title={`${asking === "cancel" ? "Cancel" : "Delete"} ${counted(count)}?`} action={asking === "cancel" ? "Cancel them" : "Delete them"}
          onConfirm={() => doAll(asking)} onClose={() => setAsking(undefined)}
        >
          <p>{consequence(asking, count)}</p>
        </Confirm>
      )}
    </div>
  );
}

/** Cancels or deletes all matching models, loaded or not, after the service has counted them. */
export function AllMatching({ which, deed, onClose }: { which: ModelFilter; deed: Deed; onClose: () => void }) {
  const [count, setCount] = useState<number>();
  const [fault, setFault] = useState<string>();
  // Keep the counted conditions, because a period moves on. Without conditions, the service
  // requires `all`.
  const [meant] = useState<Which>(() => (hasConditions(which) ? which : { all: true }));
  const conditional = !meant.all;
  const [changed, setChanged] = useState<number>();
  const apply = (dryRun: boolean) => {
    const options = { dryRun, onProgress: ({ progress }: Operation) => setChanged(progress.changed) };
    const all = deed === "cancel" ? "cancelAll" : "deleteAll";
    return ask((service) => service[all](meant, options));
  };
  useEffect(() => {
    apply(true).then(({ count }) => setCount(count), (error: unknown) => setFault(explain(error)));
  }, []);
  const confirm = () =>
    attempt(async () => {
      const { count } = await apply(false);
      toast(`${counted(count)} ${deed === "cancel" ? "cancelled" : "deleted"}.`);
    });
  const scope = conditional ? "that match the filter" : "of this service that you may change";
  return (
    <Confirm
      title={`${deed === "cancel" ? "Cancel" : "Delete"} all models${conditional ? " that match" : ""}?`} disabled={!count}
      action={deed === "cancel" ? "Cancel them" : "Delete them"} onConfirm={confirm} onClose={onClose}
    >
      {fault && <p role="alert">{fault}</p>}
      {!fault && count === undefined && <p class="soft" aria-busy="true">Counting …</p>}
      {changed !== undefined && count !== undefined && (
        <p role="status">
          <progress value={changed} max={count} /> {changed.toLocaleString("en")} of {counted(count)}.
          If you leave, it continues.
        </p>
      )}
      {count === 0 && <p>There is nothing to {deed} among the models {scope}.</p>}
      {count !== undefined && count > 0 && (
        <p>
          {counted(count)} {scope}. {consequence(deed, count)}
        </p>
      )}
    </Confirm>
  );
}

function consequence(deed: Deed, count: number): string {
  const they = count === 1 ? "It" : "They";
  return deed === "cancel" ? `${they} will have no files.` : `${they} will be removed with all files. This cannot be undone.`;
}

function counted(count: number): string {
  return count === 1 ? "1 model" : `${count.toLocaleString("en")} models`;
}
