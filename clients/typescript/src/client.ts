import { OviductConnectionError, OviductError } from "./errors.js";
import { LIMITS, openEventSource, readEvents, type EventSourceClass, type RawEvent } from "./events.js";
import { Sections } from "./sections.js";
import { absolute, sleep, Transport, type Call, type Query } from "./transport.js";
import type {
  Applied,
  Batch,
  BatchFilter,
  BatchPage,
  BatchRequest,
  BatchValidation,
  CallOptions,
  Course,
  Cut,
  CutPlane,
  Fit,
  FitEvent,
  FitFilter,
  FitPage,
  FitRequest,
  FitValidation,
  FollowFilter,
  Health,
  Manifest,
  Model,
  ModelEvent,
  ModelFilter,
  ModelPage,
  ModelRequest,
  ModelState,
  NamedView,
  Operation,
  OperationPage,
  Preset,
  PresetList,
  Report,
  SectionJson,
  Slide,
  Table,
  Validation,
  Way,
  Worker,
  WorkerList,
} from "./types.js";

/** Options of a client. */
export interface OviductOptions {
  /** API key, sent as `Authorization: Bearer`. No error and no URL contains it. */
  key?: string | undefined;
  /** Function that sends requests; the global `fetch` by default. */
  fetch?: typeof fetch | undefined;
  /**
   * Class that receives events; the global `EventSource` by default.
   *
   * With `null`, or if there is no global one, events are received with `fetch`.
   */
  eventSource?: EventSourceClass | null | undefined;
  /**
   * Maximum wait for the beginning of a response, and for its next bytes, in milliseconds; 60,000
   * by default.
   */
  timeout?: number | undefined;
  /**
   * Maximum number of attempts per request, 6 by default.
   *
   * Requests are retried without a response and after 408, 429, 502, 503 and 504.
   */
  attempts?: number | undefined;
  /** Number of consecutive failed connections after which `follow` gives up; 20 by default. */
  reconnects?: number | undefined;
  /**
   * Maximum wait between two attempts, in milliseconds; 30,000 by default.
   *
   * If `Retry-After` is longer, the call fails immediately.
   */
  maxDelay?: number | undefined;
}

/** Options of `submit`, `submitBatch`, `submitFit` and `retry`. */
export interface SubmitOptions extends CallOptions {
  /**
   * The same key with the same request gives the same result.
   *
   * A random key by default, so that retries are safe.
   */
  idempotencyKey?: string | undefined;
}

/** Options of `list`, `listBatches` and `listFits`. */
export interface ListOptions extends CallOptions {
  /** Number of entries per request, 1 to 100; 20 by default. */
  pageSize?: number | undefined;
}

/** Options of `listPage`, `listBatchesPage` and `listFitsPage`. */
export interface PageOptions extends ListOptions {
  /** `next` of the previous page. */
  cursor?: string | undefined;
}

/** Options of `cancelAll` and `deleteAll`. */
export interface BulkOptions extends CallOptions {
  /** True to only count the models. */
  dryRun?: boolean | undefined;
  /** Called with each state of the operation if there is one, for more than 1,000 models. */
  onProgress?: ((operation: Operation) => void) | undefined;
}

/** Size of the returned models: without their specs (`summary`) or with them (`full`). */
export interface ViewOptions {
  view?: "summary" | "full" | undefined;
}

/** Options of `followFit`. */
export interface FollowFitOptions extends CallOptions {
  /** `id` of the last received event, from a stream of the same models or of the same fit. */
  lastEventId?: string | undefined;
}

/** Options of `follow`. */
export interface FollowOptions extends FollowFitOptions, ViewOptions {}

/** Options of `wait`. */
export interface WaitOptions extends CallOptions {
  /** Called with each new state. */
  onProgress?: ((model: ModelState) => void) | undefined;
}

/** Options of `waitBatch`. */
export interface WaitBatchOptions extends CallOptions {
  /** Called with each new state of a model in the batch. */
  onProgress?: ((model: ModelState) => void) | undefined;
}

/** Options of `waitFit`. */
export interface WaitFitOptions extends CallOptions {
  /** Called with each new state. */
  onProgress?: ((fit: Fit) => void) | undefined;
}

/** Options of `file`. */
export interface FileOptions extends CallOptions {
  /** First and last byte, both included; a negative number means that many bytes at the end. */
  range?: readonly [first: number, last: number] | number | undefined;
}

/** Options of `bytes`. */
export interface BytesOptions extends FileOptions {
  /** Called with the number of decompressed bytes received so far. A retry starts again at 0. */
  onProgress?: ((received: number) => void) | undefined;
}

/** Options of `preview` and `previewUrl`. */
export interface PreviewOptions extends CallOptions {
  /**
   * The whole tube cut open (`opened`, the default), from outside (`whole`), or one of its ends.
   */
  view?: NamedView | undefined;
  /** Longest side in pixels, 32 to 2048; 1024 by default. */
  size?: number | undefined;
}

/** Options of `sectionPicture` and `cutPicture`. */
export interface SlideOptions extends CallOptions {
  /** Longer side in pixels, 32 to 2048; 1024 by default. */
  size?: number | undefined;
  /** Haematoxylin and eosin (the default). */
  stain?: "he" | undefined;
  /**
   * True for the tissue label of each pixel as a grey value instead of a stain.
   *
   * 0 outside, 1 lumen, 2 epithelium, 3 lamina propria, 4 circular muscle, 5 longitudinal muscle, 6
   * serosa, 7 subserosa, 8 inner longitudinal muscle, 9 vessel.
   */
  labels?: boolean | undefined;
}

/** Options of `sectionUrl` and `cutUrl`. `size`, `stain` and `labels` require the format `png`. */
export interface SlideUrlOptions extends SlideOptions {
  /** A drawing (`svg`, the default), a picture (`png`), or points (`json`). */
  format?: "svg" | "png" | "json" | undefined;
}

/** Options of `archive` and `archiveUrl`. */
export interface ArchiveOptions extends CallOptions {
  /** File names; all files by default. */
  files?: string[] | undefined;
  format?: "zip" | "tar" | undefined;
}

/** Models that `cancelAll` or `deleteAll` applies to: conditions, or explicitly all. */
export type Which = ModelFilter & { all?: boolean | undefined };

/** Time between two requests for the state of an operation, milliseconds. */
const OPERATION_POLL = 1000;

/** An event of a stream with its data. */
interface StateEvent {
  type: string;
  id: string;
  state: unknown;
}

/**
 * A client of an oviduct service.
 *
 * Members of requests and responses keep their names of the HTTP interface; `href` of files is
 * absolute.
 *
 * Every method throws {@link OviductError} for an error response, {@link OviductConnectionError} if
 * no attempt got a response, and `signal.reason` if its signal is aborted.
 */
export class Oviduct {
  readonly #transport: Transport;
  readonly #eventSource: EventSourceClass | undefined;
  readonly #reconnects: number;

  /**
   * @param url URL of the service, including the path prefix of a proxy:
   *   `https://lab.example/oviduct`.
   * @throws TypeError if the URL or the API key is invalid.
   */
  constructor(url: string | URL, options: OviductOptions = {}) {
    const { key, timeout = 60_000, attempts = 6, maxDelay = 30_000, reconnects = 20 } = options;
    const send = options.fetch ?? ((input, init) => globalThis.fetch(input, init));
    this.#transport = new Transport(url, { key, fetch: send, timeout, attempts, maxDelay });
    const found = (globalThis as { EventSource?: EventSourceClass }).EventSource;
    this.#eventSource = options.eventSource === null ? undefined : (options.eventSource ?? found);
    this.#reconnects = reconnects;
  }

  /** The URL of the service, with a final slash and without the API key. */
  get url(): string {
    return this.#transport.base.href;
  }

  // Models.

  /**
   * Requests a model. If the files of an equal model can be reused, the model has succeeded
   * already; otherwise it is queued.
   *
   * @param options.wait Seconds for which the service holds its response until the model has ended,
   *   1 to 60.
   */
  submit(request: ModelRequest = {}, options: SubmitOptions & { wait?: number | undefined } = {}): Promise<Model> {
    const { wait } = options;
    const prefer = wait === undefined ? undefined : { headers: { prefer: `wait=${wait}` }, held: wait * 1000 };
    return this.#create("models", request, options, prefer);
  }

  /**
   * Validates a request and predicts its cost, without queueing a model.
   *
   * The error of an invalid request lists every fault.
   */
  validate(request: ModelRequest, options: CallOptions = {}): Promise<Validation> {
    return this.#post("models/validate", options, request);
  }

  /** Returns the current state of a model, with its spec unless `view` is `summary`. */
  get(id: string, options: CallOptions & ViewOptions = {}): Promise<Model> {
    return this.#get(`models/${segment(id)}`, options, { view: options.view });
  }

  /** Iterates over the matching models, newest first; reads a page at a time. */
  list(filter: ModelFilter = {}, options: ListOptions & ViewOptions = {}): AsyncGenerator<Model, void> {
    return items((cursor) => this.listPage(filter, { ...options, cursor }), (page) => page.models);
  }

  /** Returns one page of the matching models, newest first. */
  listPage(filter: ModelFilter = {}, options: PageOptions & ViewOptions = {}): Promise<ModelPage> {
    const { pageSize: limit, cursor, view } = options;
    return this.#get("models", options, { ...conditions(filter), view, limit, cursor });
  }

  /**
   * Cancels a model: immediately if queued, within a second if running.
   *
   * A model that has ended does not change.
   */
  cancel(id: string, options: CallOptions = {}): Promise<Model> {
    return this.#post(`models/${segment(id)}/cancel`, options);
  }

  /** Deletes a model and its files; cancels the model first if it has not ended. */
  delete(id: string, options: CallOptions = {}): Promise<void> {
    return this.#delete(`models/${segment(id)}`, options);
  }

  /** Requests a failed model again, as a new model. */
  retry(id: string, options: SubmitOptions = {}): Promise<Model> {
    return this.#create(`models/${segment(id)}/retry`, undefined, options);
  }

  /**
   * Cancels all matching models; with `dryRun`, only counts them.
   *
   * The service changes many models in the background, as an operation. This method waits for its
   * end; the operation continues after an abort.
   */
  cancelAll(which: Which, options: BulkOptions = {}): Promise<Applied> {
    return this.#bulk("POST", "models/cancel", which, options);
  }

  /** Deletes all matching models and their files, with the options of `cancelAll`. */
  deleteAll(which: Which, options: BulkOptions = {}): Promise<Applied> {
    return this.#bulk("DELETE", "models", which, options);
  }

  async #bulk(method: "POST" | "DELETE", path: string, which: Which, options: BulkOptions): Promise<Applied> {
    const { dryRun, onProgress } = options;
    const call = this.#call(method, path, options, { ...conditions(which), dry_run: dryRun });
    let answer: Applied | Operation = await this.#transport.json(call);
    while (!("count" in answer)) {
      const { id, finished_at: end, progress }: Operation = answer;
      onProgress?.(answer);
      if (end !== null) return { count: progress.changed, dry_run: false };
      await sleep(OPERATION_POLL, options.signal);
      answer = await this.getOperation(id, options);
    }
    return answer;
  }

  /** Returns an operation on many models. The service keeps it for a week after its end. */
  getOperation(id: string, options: CallOptions = {}): Promise<Operation> {
    return this.#get(`operations/${segment(id)}`, options);
  }

  /** Iterates over operations on many models, newest first. */
  listOperations(options: ListOptions = {}): AsyncGenerator<Operation, void> {
    const page = ({ cursor, pageSize: limit }: PageOptions): Promise<OperationPage> =>
      this.#get("operations", options, { limit, cursor });
    return items((cursor) => page({ ...options, cursor }), ({ operations }) => operations);
  }

  /** Cancels an operation on many models; models that it has changed stay so. */
  cancelOperation(id: string, options: CallOptions = {}): Promise<Operation> {
    return this.#post(`operations/${segment(id)}/cancel`, options);
  }

  // Batches and studies.

  /**
   * Requests several models of one spec or of a study's points (`vary`); the service accepts all or
   * none.
   */
  submitBatch(request: BatchRequest, options: SubmitOptions = {}): Promise<Batch> {
    return this.#create("batches", request, options);
  }

  /** Validates a batch; returns its points and predicted cost, without queueing models. */
  validateBatch(request: BatchRequest, options: CallOptions = {}): Promise<BatchValidation> {
    return this.#post("batches/validate", options, request);
  }

  /** Returns a batch: the ids of its models, their number by status, and its study. */
  getBatch(id: string, options: CallOptions = {}): Promise<Batch> {
    return this.#get(`batches/${segment(id)}`, options);
  }

  /** Iterates over the matching batches, newest first, without the ids of their models. */
  listBatches(filter: BatchFilter = {}, options: ListOptions = {}): AsyncGenerator<Batch, void> {
    return items((cursor) => this.listBatchesPage(filter, { ...options, cursor }), (page) => page.batches);
  }

  /** Returns one page of the matching batches, newest first. */
  listBatchesPage(filter: BatchFilter = {}, options: PageOptions = {}): Promise<BatchPage> {
    const { pageSize: limit, cursor } = options;
    return this.#get("batches", options, { ...conditions(filter), limit, cursor });
  }

  /** Cancels all models of a batch that have not ended. */
  cancelBatch(id: string, options: CallOptions = {}): Promise<Batch> {
    return this.#post(`batches/${segment(id)}/cancel`, options);
  }

  /** Deletes a batch with all its models. */
  deleteBatch(id: string, options: CallOptions = {}): Promise<void> {
    return this.#delete(`batches/${segment(id)}`, options);
  }

  /** Returns the models of a batch as a table: varied values, seed, status and all measures. */
  table(id: string, options: CallOptions = {}): Promise<Table> {
    return this.#get(`batches/${segment(id)}/table`, options, { format: "json" });
  }

  /** Returns the table of a batch as CSV (RFC 4180). */
  tableCsv(id: string, options: CallOptions = {}): Promise<string> {
    const call = this.#call("GET", `batches/${segment(id)}/table`, options, { format: "csv" });
    return this.#transport.send(call, async (_, body) => new TextDecoder().decode(await body()));
  }

  /** Returns the URL of a batch's CSV table, for a link; see {@link downloadUrl}. */
  tableUrl(id: string, options: CallOptions = {}): Promise<string> {
    return this.#link(`batches/${segment(id)}/table`, { format: "csv" }, options);
  }

  /** Returns the files of all models of a batch as one archive, whose body is still unread. */
  archive(id: string, options: ArchiveOptions = {}): Promise<Response> {
    const call = this.#call("GET", `batches/${segment(id)}/archive`, options, archiveQuery(options));
    return this.#transport.send(call, (response) => response);
  }

  /** Returns the URL of a batch's archive, for a link; see {@link downloadUrl}. */
  archiveUrl(id: string, options: ArchiveOptions = {}): Promise<string> {
    return this.#link(`batches/${segment(id)}/archive`, archiveQuery(options), options);
  }

  // Fits.

  /** Requests a fit: a search for parameters whose models have given measures. */
  submitFit(request: FitRequest, options: SubmitOptions = {}): Promise<Fit> {
    return this.#create("fits", request, options);
  }

  /**
   * Validates a fit without queueing it.
   *
   * Returns the targets measured in its images and the parameters that it would vary.
   */
  validateFit(request: FitRequest, options: CallOptions = {}): Promise<FitValidation> {
    return this.#post("fits/validate", options, request);
  }

  /** Returns a fit: its progress, and its result after it has succeeded. */
  getFit(id: string, options: CallOptions = {}): Promise<Fit> {
    return this.#get(`fits/${segment(id)}`, options);
  }

  /** Iterates over the matching fits, newest first, without requests and results. */
  listFits(filter: FitFilter = {}, options: ListOptions = {}): AsyncGenerator<Fit, void> {
    return items((cursor) => this.listFitsPage(filter, { ...options, cursor }), (page) => page.fits);
  }

  /** Returns one page of the matching fits, newest first. */
  listFitsPage(filter: FitFilter = {}, options: PageOptions = {}): Promise<FitPage> {
    const { pageSize: limit, cursor } = options;
    return this.#get("fits", options, { ...conditions(filter), limit, cursor });
  }

  /**
   * Cancels a fit: immediately if queued, within a second if running.
   *
   * A fit that has ended does not change.
   */
  cancelFit(id: string, options: CallOptions = {}): Promise<Fit> {
    return this.#post(`fits/${segment(id)}/cancel`, options);
  }

  /** Deletes a fit; cancels it if it has not ended. */
  deleteFit(id: string, options: CallOptions = {}): Promise<void> {
    return this.#delete(`fits/${segment(id)}`, options);
  }

  // Events.

  /**
   * Follows one model or all matching models: first their current states, then every change.
   *
   * Broken connections are reopened without losing a change; the current state may then be
   * repeated. A slow reader skips states, but never the last one of a model.
   *
   * Ends after the `end` event of the model, or when all models in `ids` or `batch` have ended;
   * otherwise never. To stop earlier, use `break` or the signal.
   */
  async *follow(which: string | FollowFilter, options: FollowOptions = {}): AsyncGenerator<ModelEvent, void> {
    const one = typeof which === "string";
    const path = one ? `models/${segment(which)}/events` : "events";
    const query = one ? {} : { ids: which.ids?.join(","), label: labels(which.labels), batch: which.batch };
    const awaited = one ? new Set([which]) : which.ids && new Set(which.ids);
    const finite = !one && (which.ids !== undefined || which.batch !== undefined);
    for await (const { type, id, state } of this.#states(path, { ...query, view: options.view }, options, finite)) {
      const event = { type, id, model: state } as ModelEvent;
      yield event;
      if (event.type === "end" && awaited?.delete(event.model.id) && awaited.size === 0) return;
    }
  }

  /**
   * Follows a fit, as {@link follow} follows a model. Ends after the fit's `end` event.
   *
   * The events contain the result of the fit, but not its request.
   */
  async *followFit(id: string, options: FollowFitOptions = {}): AsyncGenerator<FitEvent, void> {
    for await (const { type, id: place, state } of this.#states(`fits/${segment(id)}/events`, {}, options)) {
      yield { type, id: place, fit: state } as FitEvent;
      if (type === "end") return;
    }
  }

  /** Waits until a model has ended; returns it, whether it succeeded, failed or was cancelled. */
  async wait(id: string, options: WaitOptions = {}): Promise<Model> {
    const { onProgress, signal } = options;
    for await (const { model } of this.follow(id, { signal })) {
      if (model.status !== "deleted") onProgress?.(model);
    }
    return this.get(id, { signal });
  }

  /**
   * Waits until all models of a batch have ended; returns the batch with their number by status.
   */
  async waitBatch(id: string, options: WaitBatchOptions = {}): Promise<Batch> {
    const { onProgress, signal } = options;
    for await (const { model } of this.follow({ batch: id }, { signal })) {
      if (model.status !== "deleted") onProgress?.(model);
    }
    return this.getBatch(id, { signal });
  }

  /** Waits until a fit has ended; returns it, whether it succeeded, failed or was cancelled. */
  async waitFit(id: string, options: WaitFitOptions = {}): Promise<Fit> {
    const { onProgress, signal } = options;
    for await (const { fit } of this.followFit(id, { signal })) {
      if (fit.status !== "deleted") onProgress?.(fit);
    }
    return this.getFit(id, { signal });
  }

  // Files of models that have succeeded.

  /**
   * Returns a file of a model, such as `model.glb`, whose body is still unread.
   *
   * With a range, the status is 206.
   */
  file(id: string, name: string, options: FileOptions = {}): Promise<Response> {
    return this.#transport.send(this.#fileCall(id, name, options), (response) => response);
  }

  /**
   * Returns the bytes of a file.
   *
   * Compares their hash with the entity tag, if the tag contains a SHA-256 and the page is secure.
   */
  bytes(id: string, name: string, options: BytesOptions = {}): Promise<ArrayBuffer> {
    return this.#transport.send(this.#fileCall(id, name, options), async (response, body) => {
      const bytes = await body(options.onProgress);
      // The entity tag of a compressed response is weak and contains the hash of the decoded bytes.
      const hash = /^(?:W\/)?"([0-9a-f]{64})"$/.exec(response.headers.get("etag") ?? "")?.[1];
      if (hash && response.status === 200 && ((await sha256(bytes)) ?? hash) !== hash) {
        throw new OviductConnectionError(`${name} of ${id} arrived damaged`);
      }
      return bytes;
    });
  }

  /**
   * Returns the URL of a file, for a link that the browser opens.
   *
   * With an API key, the URL contains a ticket for one download within 60 seconds. Therefore call
   * this method when the user asks for the file.
   */
  downloadUrl(id: string, name: string, options: CallOptions = {}): Promise<string> {
    return this.#link(`models/${segment(id)}/files/${segment(name)}`, {}, options);
  }

  /** Returns all cross sections as typed arrays. */
  async sections(id: string, options: CallOptions = {}): Promise<Sections> {
    return Sections.parse(await this.bytes(id, "sections.bin", options));
  }

  /** Returns one cross section as points in micrometres; `index` 0 is the isthmus end. */
  section(id: string, index: number, options: CallOptions = {}): Promise<SectionJson> {
    return this.#get(`models/${segment(id)}/sections/${index}`, options, { format: "json" });
  }

  /**
   * Returns the URL of a cross section, for an image or a link; see {@link downloadUrl}.
   *
   * The URL is that of a drawing unless `format` names another one.
   */
  sectionUrl(id: string, index: number, options: SlideUrlOptions = {}): Promise<string> {
    return this.#link(`models/${segment(id)}/sections/${index}`, slideQuery(options), options);
  }

  /** Returns a cross section as PNG: stained, or as tissue labels. */
  sectionPicture(id: string, index: number, options: SlideOptions = {}): Promise<Slide> {
    return this.#slide(`models/${segment(id)}/sections/${index}`, {}, options);
  }

  /**
   * Cuts the surface of a model with a plane: across the tube (`{ z_um }`), or any plane (`{
   * origin_um, normal }`).
   *
   * Sections come from the simulation; cuts come from the surface. If the surface leans, cuts show
   * islands.
   */
  cut(id: string, plane: CutPlane, options: CallOptions = {}): Promise<Cut> {
    return this.#get(`models/${segment(id)}/cut`, options, { ...planeQuery(plane), format: "json" });
  }

  /**
   * Returns the URL of a cut, for an image or a link; see {@link downloadUrl}.
   *
   * The URL is that of a drawing unless `format` names another one.
   */
  cutUrl(id: string, plane: CutPlane, options: SlideUrlOptions = {}): Promise<string> {
    return this.#link(`models/${segment(id)}/cut`, { ...planeQuery(plane), ...slideQuery(options) }, options);
  }

  /** Returns a cut as PNG: stained, or as tissue labels. */
  cutPicture(id: string, plane: CutPlane, options: SlideOptions = {}): Promise<Slide> {
    return this.#slide(`models/${segment(id)}/cut`, planeQuery(plane), options);
  }

  /**
   * Returns a way through the lumen from one end of a model to the other, in millimetres.
   *
   * The service certifies its distance from the mucosa.
   */
  way(id: string, options: CallOptions = {}): Promise<Way> {
    return this.#get(`models/${segment(id)}/way`, options);
  }

  /** Returns a picture of a model as PNG. */
  preview(id: string, options: PreviewOptions = {}): Promise<ArrayBuffer> {
    const { view, size } = options;
    const call = this.#call("GET", `models/${segment(id)}/preview.png`, options, { view, size });
    return this.#transport.send(call, (_, body) => body());
  }

  /** Returns the URL of a picture of a model, for an image; see {@link downloadUrl}. */
  previewUrl(id: string, options: PreviewOptions = {}): Promise<string> {
    const { view, size } = options;
    return this.#link(`models/${segment(id)}/preview.png`, { view, size }, options);
  }

  /** Returns the report of a model: certificate, summary, and the backend that computed it. */
  report(id: string, options: CallOptions = {}): Promise<Report> {
    return this.#get(`models/${segment(id)}/report`, options);
  }

  /** Returns the centre line of a model, as points with local frames, in millimetres. */
  course(id: string, options: CallOptions = {}): Promise<Course> {
    return this.#get(`models/${segment(id)}/course`, options);
  }

  /**
   * Returns the manifest of a model: bodies, units, patches, sizes, hashes, origin, licence and
   * citation.
   */
  manifest(id: string, options: CallOptions = {}): Promise<Manifest> {
    return this.#get(`models/${segment(id)}/manifest.json`, options);
  }

  /** Returns the URL of the report page to view or print, for a link; see {@link downloadUrl}. */
  reportPageUrl(id: string, options: CallOptions = {}): Promise<string> {
    return this.#link(`models/${segment(id)}/report.html`, {}, options);
  }

  // The service.

  /** Returns name, title and subject of each preset, the default first. */
  presets(options: CallOptions = {}): Promise<PresetList> {
    return this.#get("presets", options);
  }

  /** Returns a preset with the source of each value. */
  preset(name: string, options: CallOptions = {}): Promise<Preset> {
    return this.#get(`presets/${segment(name)}`, options);
  }

  /** Returns the JSON Schema of a spec. */
  schema(options: CallOptions = {}): Promise<Record<string, unknown>> {
    return this.#get("schema", options);
  }

  /** Returns the state and version of the service; fails without retries. */
  health(options: CallOptions = {}): Promise<Health> {
    return this.#transport.json({ ...this.#call("GET", "healthz", options), once: true });
  }

  /** Checks that the service accepts work; otherwise fails with `not-ready`, without retries. */
  ready(options: CallOptions = {}): Promise<Health> {
    return this.#transport.json({ ...this.#call("GET", "readyz", options), once: true });
  }

  /** Returns the workers that sent a heartbeat within the last minutes, with their running jobs. */
  workers(options: CallOptions = {}): Promise<WorkerList> {
    return this.#get("workers", options);
  }

  /**
   * Pauses all workers: running models continue, and no new ones start.
   *
   * Needs the scope `admin`, like the next four methods.
   */
  pauseWorkers(options: CallOptions = {}): Promise<WorkerList> {
    return this.#post("workers/pause", options);
  }

  /** Ends the pause of all workers; individually paused workers stay paused. */
  resumeWorkers(options: CallOptions = {}): Promise<WorkerList> {
    return this.#post("workers/resume", options);
  }

  /** Pauses one worker. */
  pauseWorker(id: string, options: CallOptions = {}): Promise<Worker> {
    return this.#post(`workers/${segment(id)}/pause`, options);
  }

  /** Ends the pause of one worker. */
  resumeWorker(id: string, options: CallOptions = {}): Promise<Worker> {
    return this.#post(`workers/${segment(id)}/resume`, options);
  }

  /** Drains one worker: it completes its running models and starts no more until it is resumed. */
  drainWorker(id: string, options: CallOptions = {}): Promise<Worker> {
    return this.#post(`workers/${segment(id)}/drain`, options);
  }

  #call(method: Call["method"], path: string, options: CallOptions, query: Query = {}): Call {
    return { method, path, query, signal: options.signal };
  }

  #get<T>(path: string, options: CallOptions, query?: Query): Promise<T> {
    return this.#transport.json(this.#call("GET", path, options, query));
  }

  #post<T>(path: string, options: CallOptions, body?: unknown, query?: Query): Promise<T> {
    return this.#transport.json({ ...this.#call("POST", path, options, query), body });
  }

  #delete<T>(path: string, options: CallOptions, query?: Query): Promise<T> {
    return this.#transport.json(this.#call("DELETE", path, options, query));
  }

  #create<T>(path: string, body: unknown, options: SubmitOptions, more: Partial<Call> = {}): Promise<T> {
    const headers = { "idempotency-key": options.idempotencyKey ?? randomKey(), ...more.headers };
    return this.#transport.json({ ...this.#call("POST", path, options), body, ...more, headers });
  }

  #fileCall(id: string, name: string, options: FileOptions): Call {
    const { range } = options;
    const call = this.#call("GET", `models/${segment(id)}/files/${segment(name)}`, options);
    if (range === undefined) return call;
    return { ...call, headers: { range: typeof range === "number" ? `bytes=${range}` : `bytes=${range[0]}-${range[1]}` } };
  }

  /** Returns a picture of a section or a cut. */
  #slide(path: string, place: Query, options: SlideOptions): Promise<Slide> {
    const call = this.#call("GET", path, options, { ...place, ...slideQuery({ ...options, format: "png" }) });
    return this.#transport.send(call, async (response, body) => ({
      um_per_pixel: Number(response.headers.get("um-per-pixel")),
      png: await body(),
    }));
  }

  /** Returns a URL that works once without the API key. */
  async #link(path: string, query: Query, options: CallOptions, once = false): Promise<string> {
    if (!this.#transport.hasKey) return this.#transport.url(path, query).href;
    // The ticket is for the path at the service, because a proxy strips its prefix.
    const call = { ...this.#call("POST", "tickets", options), body: { path: `/${path}` }, once };
    const { ticket } = await this.#transport.json<{ ticket: string }>(call);
    return this.#transport.url(path, { ...query, ticket }).href;
  }

  /**
   * Yields the events of a stream, which is reopened when it breaks.
   *
   * @param finite True if the service ends a stream of several models, by an id without an event.
   */
  async *#states(
    path: string,
    query: Query,
    options: FollowFitOptions,
    finite = false,
  ): AsyncGenerator<StateEvent, void> {
    const { signal } = options;
    let last = options.lastEventId;
    let byFetch = false;
    for (let failures = 0; ; ) {
      let opened: number | undefined;
      let problem: unknown;
      try {
        const call = this.#call("GET", path, options, { ...query, last_event_id: last });
        const events = await this.#connect(call, byFetch);
        if (events === undefined) return;
        opened = Date.now();
        for await (const raw of events) {
          failures = 0;
          last = raw.id || last;
          if (raw.data === "") continue;
          const state = absolute(JSON.parse(raw.data), this.#transport.url(path).href);
          yield { type: raw.type, id: raw.id, state };
        }
        // The final id tells every process of the service that all models have ended. It comes
        // without an event, so only `fetch` receives it.
        byFetch = finite;
      } catch (error) {
        problem = error;
      }
      signal?.throwIfAborted();
      // Only a stream that was open counts as success, however long the attempt took.
      failures = opened !== undefined && Date.now() - opened > LIMITS.lasting ? 1 : failures + 1;
      const wait = this.#transport.delay(failures, problem);
      if (wait === undefined) throw problem;
      if (failures > this.#reconnects) {
        throw problem ?? new OviductConnectionError(`GET ${this.url}${path}: the stream breaks off again and again`);
      }
      // With an unknown id, the stream also reports models that have ended in the meantime.
      last ??= "none";
      await sleep(wait, signal);
    }
  }

  /** Opens a stream of events; returns undefined if the stream has ended. */
  async #connect(call: Call, byFetch: boolean): Promise<AsyncGenerator<RawEvent, void> | undefined> {
    const { path, query = {}, signal } = call;
    if (this.#eventSource && !byFetch) {
      const url = await this.#link(path, query, { signal }, true);
      const events = await openEventSource(this.#eventSource, url, this.#transport.timeout, signal);
      if (events) return events;
    }
    // An `EventSource` hides the reason of a refusal. The response to the same request with `fetch`
    // contains the reason, or the stream.
    return this.#transport.send({ ...call, headers: { accept: "text/event-stream" }, once: true }, (response) =>
      response.status === 204 || !response.body ? undefined : readEvents(response.body),
    );
  }
}

function planeQuery({ z_um, origin_um, normal }: CutPlane): Query {
  return { z_um, origin_um: origin_um?.join(","), normal: normal?.join(",") };
}

function slideQuery({ format = "svg", size, stain, labels }: SlideUrlOptions): Query {
  return { format, size, stain, labels };
}

/** Encodes one path segment; throws TypeError for a segment that would lead to another path. */
function segment(text: string): string {
  if (text === "" || text === "." || text === "..") throw new TypeError(`"${text}" is no id or name`);
  return encodeURIComponent(text);
}

/** Yields the items of all pages of a list. */
async function* items<P extends { next?: string | null }, T>(
  page: (cursor: string | undefined) => Promise<P>,
  of: (page: P) => T[],
): AsyncGenerator<T, void> {
  let cursor: string | undefined;
  do {
    const found = await page(cursor);
    yield* of(found);
    cursor = found.next ?? undefined;
  } while (cursor !== undefined);
}

function labels(own: Record<string, string> | undefined): string[] | undefined {
  return own && Object.entries(own).map(([key, value]) => `${key}:${value}`);
}

function conditions(which: Which): Query {
  const { labels: own, created_after: after, created_before: before, ...same } = which;
  const time = (at: string | Date | undefined) => (at instanceof Date ? at.toISOString() : at);
  return { ...same, label: labels(own), created_after: time(after), created_before: time(before) };
}

function archiveQuery({ files, format }: ArchiveOptions): Query {
  return { files: files?.join(","), format };
}

/** 128 random bits. Insecure pages have no `crypto.randomUUID`. */
function randomKey(): string {
  return hex(crypto.getRandomValues(new Uint8Array(16)));
}

/** SHA-256 in hexadecimal; undefined in an insecure page. */
async function sha256(bytes: ArrayBuffer): Promise<string | undefined> {
  return crypto.subtle && hex(new Uint8Array(await crypto.subtle.digest("SHA-256", bytes)));
}

function hex(bytes: Uint8Array): string {
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
