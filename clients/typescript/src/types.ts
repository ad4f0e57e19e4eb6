/** Friendly names for the types of `schema.ts`, which is generated from `openapi.yaml`. Members have their names on the wire. */

import type { components, operations } from "./schema.js";

type Schemas = components["schemas"];
type Content<R> = R extends { content: { "application/json": infer T } } ? T : never;
/** The JSON of the successful answers of an operation. */
export type Answer<Name extends keyof operations> = {
  [Status in keyof operations[Name]["responses"]]: Status extends 200 | 201 | 202
    ? Content<operations[Name]["responses"][Status]>
    : never;
}[keyof operations[Name]["responses"]];
/** The JSON that an operation is sent. */
type Body<Name extends keyof operations> = Content<NonNullable<operations[Name]["requestBody"]>>;

/** What to grow; `{}` is the default preset with a random seed. */
export type ModelRequest = Body<"create_model">;
/** A model: its request, its progress and its result. */
export type Model = Answer<"get_model">;
export type ModelPage = Answer<"list_models">;
export type ModelFile = Model["files"][number];
export type Status = Model["status"];
export type Progress = NonNullable<Model["progress"]>;
/** What a valid request would queue: the resolved spec and its predicted cost. */
export type Validation = Answer<"validate_model">;
/** Many models of one spec, or of the points of a study. */
export type BatchRequest = Body<"create_batch">;
/** A parameter study: values by JSON pointers into the spec, and how they are combined. */
export type Vary = NonNullable<BatchRequest["vary"]>;
export type Batch = Answer<"get_batch">;
export type BatchPage = Answer<"list_batches">;
export type BatchValidation = Answer<"validate_batch">;
/** What to fit: measures to be reached, from figures or images of sections. */
export type FitRequest = Body<"create_fit">;
/** A fit: its request, its progress and its result. */
export type Fit = Answer<"get_fit">;
export type FitPage = Answer<"list_fits">;
/** What a valid request for a fit would queue. */
export type FitValidation = Answer<"validate_fit">;
/** One row for each model of a batch. */
export type Table = Answer<"get_batch_table">;
/** How many models were, or would be, cancelled or deleted. */
export type Applied = Answer<"cancel_models">;
/** A cross section with its two contours; lengths in micrometres. */
export type SectionJson = Answer<"get_section">;
/** A planar cut of the surface; lengths in micrometres. */
export type Cut = Answer<"cut_model">;
/** A ring of a cut: `points` are u and v in its plane. */
export type CutRing = Schemas["CutRingAnswer"];
/** What a ring of a cut bounds. */
export type RingKind = Schemas["RingKind"];
/** The plane of a cut, with the directions of u and v. */
export type Plane = Schemas["PlaneAnswer"];
/** Where to cut, in micrometres: across the tube at `z_um`, where u is x and v is y, or through a point with a normal of any length. */
export type CutPlane =
  | { z_um: number; origin_um?: undefined; normal?: undefined }
  | { z_um?: undefined; origin_um: readonly [x: number, y: number, z: number]; normal: readonly [x: number, y: number, z: number] };
/** A picture of a section or a cut. */
export interface Slide {
  /** The bytes of a PNG. */
  png: ArrayBuffer;
  /** Side of a pixel, micrometres. */
  um_per_pixel: number;
}
/** What a picture of a model shows. */
export type NamedView = Schemas["NamedView"];
/** The certificate and the summary of a model, and what computed it. */
export type Report = Answer<"get_report">;
export type Manifest = Answer<"get_manifest">;
/** The centre line that a model follows. */
export type Course = Answer<"get_course">;
export type PresetList = Answer<"list_presets">;
export type Preset = Answer<"get_preset">;
export type Worker = Answer<"drain_worker">;
export type WorkerList = Answer<"list_workers">;
export type Health = Answer<"get_health">;

/** A problem as the service sends it (RFC 9457). */
export type Problem = Schemas["Problem"];
/** Types of the problems, `urn:oviduct:problem:` and a slug. */
export type ProblemType = Problem["type"];
/** One fault of a request: what is wrong (`detail`) and where (`pointer`, `parameter` or `header`). */
export type Fault = NonNullable<Problem["errors"]>[number];
type Slug<T> = T extends `urn:oviduct:problem:${infer S}` ? S : never;
/** The last part of a {@link ProblemType}, such as `unauthorized`. */
export type ProblemSlug = Slug<ProblemType>;

/**
 * The state of a model in an event. It has no `spec`, unless `view` is `full`; in `section` events, `section` is the latest
 * contour in micrometres, thinned so that a page can draw it.
 */
export type ModelState = Schemas["ModelEvent"];
/** What the last event of a deleted model holds. */
export type DeletedModel = Schemas["DeletedEvent"];
/** The present state of a model, and what has changed in it. */
export type ModelEvent = {
  /** What has changed; `end` is the last event of a model. */
  type: "status" | "progress" | "section" | "end";
  /** Place in the stream, for `lastEventId`. */
  id: string;
  model: ModelState | DeletedModel;
};

/** The present state of a fit, without its request, and what has changed in it. */
export type FitEvent = {
  /** What has changed; `end` is the last event of a fit. */
  type: "status" | "progress" | "end";
  /** Place in the stream, for `lastEventId`. */
  id: string;
  fit: Fit | Schemas["DeletedEvent"];
};

/** Which models are meant; a model must match all conditions. */
export interface ModelFilter {
  status?: Status | undefined;
  preset?: string | undefined;
  labels?: Record<string, string> | undefined;
  /** Id of a batch. */
  batch?: string | undefined;
  /** Only keys with the scope `admin` may name another owner than their own. */
  owner?: string | undefined;
  /** The start is included. */
  created_after?: string | Date | undefined;
  /** The end is not included. */
  created_before?: string | Date | undefined;
}

/** Which batches are meant. */
export type BatchFilter = Pick<ModelFilter, "owner" | "created_after" | "created_before">;

/** Which fits are meant. */
export type FitFilter = Omit<ModelFilter, "batch">;

/** Which models to follow; `{}` is all that the key may read. */
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
