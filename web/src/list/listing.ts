// The models that the list shows: pages of the service, and what happens to their models meanwhile.
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { OviductError, type ModelFilter, type ModelState } from "oviduct-client";
import { forget, known, remember } from "../models.ts";
import { ask, explain, session } from "../service.ts";
import { reconnections } from "../stream.ts";
import { conditions, matches, writeFilter, type Filter } from "./filter.ts";

const PAGE = 30;
/** Most models of one answer. */
const LARGEST_PAGE = 100;

/** How far the list has been read. */
interface Reach {
  /** The oldest id that was read; "" if there are no older models. */
  oldest: string;
  cursor: string | undefined;
}

export interface Listing {
  /** What the service was asked for. */
  which: ModelFilter;
  /** Undefined until the first page was read. */
  models: ModelState[] | undefined;
  /** Reads older models; undefined if there are none. */
  more: (() => void) | undefined;
  reading: boolean;
  fault: string | undefined;
  /** Reads again what could not be read. */
  retry: () => void;
}

/** How far lists were read for the present key, by their filters: they are as long when one comes back to them. */
const reached = new Map<string, Reach>();
let owner: number | undefined;

export function useListing(filter: Filter): Listing {
  if (owner !== session.value) reached.clear();
  owner = session.value;
  const query = writeFilter(filter).toString();
  const present = reached.get(query);
  const which = useMemo(() => conditions(filter, Date.now()), [query]);
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
      if (!signal.aborted) reached.set(query, reach);
    } catch (error) {
      if (!signal.aborted) setFault(explain(error));
    } finally {
      if (!signal.aborted) setReading(false);
    }
  };
  // What was read may be outdated once the stream was lost.
  useEffect(() => {
    void read((signal) => readDownTo(which, present?.oldest, signal));
    return () => abort.current.abort();
  }, [query, reconnections.value, retries]);

  return {
    which,
    models: present && known().filter((model) => model.id >= present.oldest && matches(model, which)),
    more: present?.cursor === undefined ? undefined : () => void read((signal) => readPage(which, present.cursor, PAGE, signal)),
    reading,
    fault,
    retry: () => setRetries(retries + 1),
  };
}

async function readPage(which: ModelFilter, cursor: string | undefined, pageSize: number, signal: AbortSignal): Promise<Reach> {
  const { models, next } = await ask((service) => service.listPage(which, { cursor, pageSize, view: "summary", signal }));
  signal.throwIfAborted();
  remember(models);
  return { oldest: next ? (models.at(-1)?.id ?? "") : "", cursor: next ?? undefined };
}

/** Reads the newest models; all down to `oldest` if that is given, and drops those that are gone. */
async function readDownTo(which: ModelFilter, oldest: string | undefined, signal: AbortSignal): Promise<Reach> {
  if (oldest === undefined) return readPage(which, undefined, PAGE, signal);
  const missing = new Map(known().filter((model) => model.id >= oldest && matches(model, which)).map((model) => [model.id, model]));
  let cursor: string | undefined;
  for (;;) {
    const page = await ask((service) => service.listPage(which, { cursor, pageSize: LARGEST_PAGE, view: "summary", signal }));
    signal.throwIfAborted();
    remember(page.models);
    for (const { id } of page.models) missing.delete(id);
    const last = page.models.at(-1)?.id ?? "";
    cursor = page.next ?? undefined;
    if (cursor === undefined || last <= oldest) {
      await Promise.all([...missing.keys()].map((id) => check(id, signal)));
      return { oldest: cursor === undefined ? "" : last, cursor };
    }
  }
}

/** A model that the service no longer lists was deleted, or has changed. */
async function check(id: string, signal: AbortSignal): Promise<void> {
  try {
    remember([await ask((service) => service.get(id, { view: "summary", signal }))]);
  } catch (error) {
    if (!(error instanceof OviductError && error.is("model-not-found"))) throw error;
    forget(id);
  }
}
