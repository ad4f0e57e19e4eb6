/**
 * Short names for the types of `schema.ts`, which is generated from `openapi.yaml`.
 *
 * Members keep their names of the HTTP interface.
 */

import type { components, operations } from "./schema.js";

type Schemas = components["schemas"];
type Content<R> = R extends { content: { "application/json": infer T } } ? T : never;
/** JSON of the successful responses of an operation. */
export type Answer<Name extends keyof operations> = {
  [Status in keyof operations[Name]["responses"]]: Status extends 200 | 201 | 202
    ? Content<operations[Name]["responses"][Status]>
    : never;
}[keyof operations[Name]["responses"]];
/** JSON of the request body of an operation. */
type Body<Name extends keyof operations> = Content<NonNullable<operations[Name]["requestBody"]>>;

/** The model to grow; `{}` is the default preset with a random seed. */
export type ModelRequest = Body<"create_model">;
/** A model: its request, progress and result. */
export type Model = Answer<"get_model">;
export type ModelPage = Answer<"list_models">;
export type ModelFile = Model["files"][number];
export type Status = Model["status"];
export type Progress = NonNullable<Model["progress"]>;
/** The model that a valid request would queue: the resolved spec and its predicted cost. */
export type Validation = Answer<"validate_model">;
/** Several models of one spec, or of the points of a study. */
export type BatchRequest = Body<"create_batch">;
/** A parameter study: values by JSON pointer into the spec, and their combination. */
export type Vary = NonNullable<BatchRequest["vary"]>;
export type Batch = Answer<"get_batch">;
export type BatchPage = Answer<"list_batches">;
export type BatchValidation = Answer<"validate_batch">;
/** A fit to request: the measures to reach, as numbers or as images of sections. */
export type FitRequest = Body<"create_fit">;
/** A fit: its request, progress and result. */
export type Fit = Answer<"get_fit">;
export type FitPage = Answer<"list_fits">;
/** The fit that a valid request would queue. */
export type FitValidation = Answer<"validate_fit">;
/** One row per model of a batch. */
export type Table = Answer<"get_batch_table">;
/** Number of models that were cancelled or deleted, or would be with `dryRun`. */
export type Applied = Schemas["Applied"];
/** Cancellation or deletion of many models, which the service executes in the background. */
export type Operation = Schemas["Operation"];
export type OperationPage = Answer<"list_operations">;
/** A cross section with its two contours; lengths in micrometres. */
export type SectionJson = Answer<"get_section">;
/** A planar cut of the surface; lengths in micrometres. */
export type Cut = Answer<"cut_model">;
/** A ring of a cut; `points` are u and v in its plane. */
export type CutRing = Schemas["CutRingAnswer"];
/** Kind of a ring: what it bounds. */
export type RingKind = Schemas["RingKind"];
/** The plane of a cut, with the directions of u and v. */
export type Plane = Schemas["PlaneAnswer"];
/**
 * Plane of a cut, in micrometres: across the tube at `z_um`, or through a point with a normal of
 * any length.
 *
 * At `z_um`, u is x and v is y.
 */
export type CutPlane =
  | { z_um: number; origin_um?: undefined; normal?: undefined }
  | { z_um?: undefined; origin_um: readonly [x: number, y: number, z: number]; normal: readonly [x: number, y: number, z: number] };
/** A way through the lumen that touches nothing. */
export type Way = Answer<"get_way">;
/** A point of a way. */
export type WayPoint = Way["points"][number];
/** A picture of a section or a cut. */
export interface Slide {
  /** Bytes of a PNG file. */
  png: ArrayBuffer;
  /** Side of a pixel, micrometres. */
  um_per_pixel: number;
}
/** View of a model in a picture. */
export type NamedView = Schemas["NamedView"];
/** Report of a model: certificate, summary, and the backend that computed it. */
export type Report = Answer<"get_report">;
export type Manifest = Answer<"get_manifest">;
/** The centre line of a model. */
export type Course = Answer<"get_course">;
export type PresetList = Answer<"list_presets">;
export type Preset = Answer<"get_preset">;
export type Worker = Answer<"drain_worker">;
export type WorkerList = Answer<"list_workers">;
export type Health = Answer<"get_health">;

/** A problem as the service sends it (RFC 9457). */
export type Problem = Schemas["Problem"];
/** Problem types: `urn:oviduct:problem:` and a slug. */
export type ProblemType = Problem["type"];
/**
 * One fault of a request: a description (`detail`) and its place (`pointer`, `parameter` or
 * `header`).
 */
export type Fault = NonNullable<Problem["errors"]>[number];
type Slug<T> = T extends `urn:oviduct:problem:${infer S}` ? S : never;
/** Last part of a {@link ProblemType}, such as `unauthorized`. */
export type ProblemSlug = Slug<ProblemType>;

/**
 * The state of a model in an event.
 *
 * `spec` is present only with the view `full`. In `section` events, `section` is the latest section
 * in micrometres, thinned for drawing.
 */
export type ModelState = Schemas["ModelEvent"];
/** Content of the last event of a deleted model. */
export type DeletedModel = Schemas["DeletedEvent"];
/** The current state of a model, and the kind of change. */
export type ModelEvent = {
  /** Kind of change; `end` is the last event of a model. */
  type: "status" | "progress" | "section" | "end";
  /** Cursor of the stream, for `lastEventId`. */
  id: string;
  model: ModelState | DeletedModel;
};

/** The current state of a fit without its request, and the kind of change. */
export type FitEvent = {
  /** Kind of change; `end` is the last event of a fit. */
  type: "status" | "progress" | "end";
  /** Cursor of the stream, for `lastEventId`. */
  id: string;
  fit: Fit | Schemas["DeletedEvent"];
};

/** Conditions on models; a model must match all of them. */
export interface ModelFilter {
  status?: Status | undefined;
  preset?: string | undefined;
  labels?: Record<string, string> | undefined;
  /** Id of a batch. */
  batch?: string | undefined;
  /**
   * Owner of the models. Only API keys with the scope `admin` may name another owner than their
   * own.
   */
  owner?: string | undefined;
  /** Earliest time of acceptance, included. */
  created_after?: string | Date | undefined;
  /** Latest time of acceptance, excluded. */
  created_before?: string | Date | undefined;
}

/** Conditions on batches. */
export type BatchFilter = Pick<ModelFilter, "owner" | "created_after" | "created_before">;

/** Conditions on fits. */
export type FitFilter = Omit<ModelFilter, "batch">;

/** Conditions on models to follow; `{}` means all models that the API key may read. */
export interface FollowFilter {
  /** At most 100. */
  ids?: string[] | undefined;
  labels?: Record<string, string> | undefined;
  batch?: string | undefined;
}

/** Options of every method. */
export interface CallOptions {
  /** Aborts the call, its waits and retries; the call then throws `signal.reason`. */
  signal?: AbortSignal | undefined;
}
