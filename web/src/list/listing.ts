// The models in the list: the newest known models within the range that was read from the service.
import { computed, signal } from "@preact/signals";
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { OviductError, type ModelFilter, type ModelState } from "oviduct-client";
import { drops, forget, known, remember } from "../models.ts";
import { ask, explain, session } from "../service.ts";
import { reconnections } from "../stream.ts";
import { now } from "../ui/widgets.tsx";
import { conditions, hasConditions, matches, writeFilter, type Filter } from "./filter.ts";
import { settle } from "./settle.ts";

/** Number of models shown at first and added per step. */
const PAGE = 50;
/** Maximum number of models per response. */
const LARGEST_PAGE = 100;
/** Maximum number of models that are read again on return to a list; a longer list is cut. */
const READ_AGAIN = 200;

/** The read range of a list, and the number of its shown models. */
interface Reach {
  /** Oldest id that was read; "" if there are no older models. */
  oldest: string;
  cursor: string | undefined;
  rows: number;
  /**
   * Value of `drops` when reading began. If `drops` has increased, models within the range may be
   * missing.
   */
  drops: number;
}
/** Initial value of `oldest`: greater than all ids. */
const NOTHING = "~";

export interface Listing {
  /** Conditions of the requests to the service. */
  which: ModelFilter;
  /** Undefined until the first page has been read. */
  models: ModelState[] | undefined;
  /** Shows older models; undefined if there are none. */
  more: (() => void) | undefined;
  reading: boolean;
  fault: string | undefined;
  /** Repeats the failed request. */
  retry: () => void;
}

/** Ranges by session and filter, so that a list has the same length on return. */
const reached = signal<ReadonlyMap<string, Reach>>(new Map());
const minute = computed(() => Math.floor(now.value / 60_000) * 60_000);

export function useListing(filter: Filter): Listing {
  const query = writeFilter(filter).toString();
  const list = `${session.value} ${query}`;
  const present = reached.value.get(list);
  // Periods end at the current time, so their beginning moves.
  const until = filter.within && minute.value;
  const which = useMemo(() => conditions(filter, until ?? 0), [query, until]);
  const [reading, setReading] = useState(true);
  const [fault, setFault] = useState<string>();
  const [retries, setRetries] = useState(0);
  const abort = useRef(new AbortController());

  const read = async (what: (signal: AbortSignal) => Promise<Reach>) => {
    abort.current.abort();
    const { signal } = (abort.current = new AbortController());
    setReading(true);
    setFault(undefined);
    try {
      const reach = await what(signal);
      if (!signal.aborted) setReach(list, reach);
    } catch (error) {
      if (!signal.aborted) setFault(explain(error));
    } finally {
      if (!signal.aborted) setReading(false);
    }
  };
  // The read models may be outdated after the stream was lost.
  useEffect(() => {
    void read((signal) => readNewest(which, Math.min(present?.rows ?? PAGE, READ_AGAIN), signal));
    return () => abort.current.abort();
  }, [list, reconnections.value, retries]);

  // Include the models of the next step, which show whether that step must be read.
  const found = present && newest(present, which, present.rows + PAGE);
  const more = (reach: Reach) => {
    const longer = { ...reach, rows: reach.rows + PAGE };
    if (reach.drops !== drops) void read((signal) => readNewest(which, longer.rows, signal));
    else if (reach.cursor === undefined || found?.length === longer.rows) setReach(list, longer);
    else void read((signal) => readPage(which, longer, PAGE, signal));
  };
  return {
    which,
    models: found?.slice(0, present?.rows),
    more: present && (present.cursor !== undefined || present.drops !== drops || found!.length > present.rows) ? () => more(present) : undefined,
    reading,
    fault,
    retry: () => setRetries(retries + 1),
  };
}

function setReach(list: string, reach: Reach): void {
  reached.value = new Map(reached.peek()).set(list, reach);
}

/** The newest known models that match, within the read range. */
function newest({ oldest }: Reach, which: ModelFilter, count: number): ModelState[] {
  const found: ModelState[] = [];
  for (const model of known()) {
    if (model.id < oldest || found.length === count) break;
    if (matches(model, which)) found.push(model);
  }
  return found;
}

/** Reads a list from its beginning, for this number of rows. */
async function readNewest(which: ModelFilter, rows: number, signal: AbortSignal): Promise<Reach> {
  let reach: Reach = { oldest: NOTHING, cursor: undefined, rows, drops };
  for (let left = rows; left > 0; left -= LARGEST_PAGE) {
    reach = await readPage(which, reach, Math.min(left, LARGEST_PAGE), signal);
    if (reach.cursor === undefined) break;
  }
  return reach;
}

/** Continues a range, and drops known models that the service has stopped listing. */
async function readPage(which: ModelFilter, { oldest: from, cursor, ...reach }: Reach, pageSize: number, signal: AbortSignal): Promise<Reach> {
  const before = [...known()].filter((model) => model.id < from && matches(model, which));
  const { models, next } = await ask((service) => service.listPage(which, { cursor, pageSize, view: "summary", signal }));
  signal.throwIfAborted();
  remember(models);
  const oldest = next ? (models.at(-1)?.id ?? "") : "";
  const listed = new Set(models.map(({ id }) => id));
  const unlisted = before.filter(({ id }) => id >= oldest && !listed.has(id));
  if (hasConditions(which)) {
    // These models were deleted or have changed.
    const [failed] = await settle(unlisted, ({ id }) => check(id, signal));
    if (failed) throw failed.error;
  } else {
    for (const { id } of unlisted) forget(id);
  }
  return { ...reach, oldest, cursor: next ?? undefined };
}

async function check(id: string, signal: AbortSignal): Promise<void> {
  try {
    remember([await ask((service) => service.get(id, { view: "summary", signal }))]);
  } catch (error) {
    if (!(error instanceof OviductError && error.is("model-not-found"))) throw error;
    forget(id);
  }
}
