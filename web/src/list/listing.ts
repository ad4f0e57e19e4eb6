// The models that the list shows: the newest known ones within what was read of the service.
import { computed, signal } from "@preact/signals";
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { OviductError, type ModelFilter, type ModelState } from "oviduct-client";
import { drops, forget, known, remember } from "../models.ts";
import { ask, explain, session } from "../service.ts";
import { reconnections } from "../stream.ts";
import { now } from "../ui/widgets.tsx";
import { conditions, hasConditions, matches, writeFilter, type Filter } from "./filter.ts";
import { settle } from "./settle.ts";

/** Models that are shown at first, and with each further step. */
const PAGE = 50;
/** Most models of one answer. */
const LARGEST_PAGE = 100;
/** Most models that are read again when one comes back to a list; a longer one is cut. */
const READ_AGAIN = 200;

/** How far a list has been read, and how much of it is shown. */
interface Reach {
  /** The oldest id that was read; "" if there are no older models. */
  oldest: string;
  cursor: string | undefined;
  rows: number;
  /** Value of `drops` when reading began: if it has grown, models may be missing within the reach. */
  drops: number;
}
/** Before anything is read: an id that is newer than all. */
const NOTHING = "~";

export interface Listing {
  /** What the service was asked for. */
  which: ModelFilter;
  /** Undefined until the first page was read. */
  models: ModelState[] | undefined;
  /** Shows older models; undefined if there are none. */
  more: (() => void) | undefined;
  reading: boolean;
  fault: string | undefined;
  /** Reads again what could not be read. */
  retry: () => void;
}

/** By session and filter: lists are as long when one comes back to them. */
const reached = signal<ReadonlyMap<string, Reach>>(new Map());
const minute = computed(() => Math.floor(now.value / 60_000) * 60_000);

export function useListing(filter: Filter): Listing {
  const query = writeFilter(filter).toString();
  const list = `${session.value} ${query}`;
  const present = reached.value.get(list);
  // Periods end now, so what they begin with moves on.
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
  // What was read may be outdated once the stream was lost.
  useEffect(() => {
    void read((signal) => readNewest(which, Math.min(present?.rows ?? PAGE, READ_AGAIN), signal));
    return () => abort.current.abort();
  }, [list, reconnections.value, retries]);

  // Those of the next step too, which tell whether it must be read.
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

/** The newest known models that match, within what was read. */
function newest({ oldest }: Reach, which: ModelFilter, count: number): ModelState[] {
  const found: ModelState[] = [];
  for (const model of known()) {
    if (model.id < oldest || found.length === count) break;
    if (matches(model, which)) found.push(model);
  }
  return found;
}

/** Reads a list from its beginning, for so many rows. */
async function readNewest(which: ModelFilter, rows: number, signal: AbortSignal): Promise<Reach> {
  let reach: Reach = { oldest: NOTHING, cursor: undefined, rows, drops };
  for (let left = rows; left > 0; left -= LARGEST_PAGE) {
    reach = await readPage(which, reach, Math.min(left, LARGEST_PAGE), signal);
    if (reach.cursor === undefined) break;
  }
  return reach;
}

/** Reads on from a reach, and drops models that are known there but no longer listed. */
async function readPage(which: ModelFilter, { oldest: from, cursor, ...reach }: Reach, pageSize: number, signal: AbortSignal): Promise<Reach> {
  const before = [...known()].filter((model) => model.id < from && matches(model, which));
  const { models, next } = await ask((service) => service.listPage(which, { cursor, pageSize, view: "summary", signal }));
  signal.throwIfAborted();
  remember(models);
  const oldest = next ? (models.at(-1)?.id ?? "") : "";
  const listed = new Set(models.map(({ id }) => id));
  const unlisted = before.filter(({ id }) => id >= oldest && !listed.has(id));
  if (hasConditions(which)) {
    // They were deleted, or have changed.
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
