export { Oviduct } from "./client.js";
export type {
  ArchiveOptions,
  BulkOptions,
  BytesOptions,
  FileOptions,
  FollowFitOptions,
  FollowOptions,
  ListOptions,
  OviductOptions,
  PageOptions,
  PreviewOptions,
  SlideOptions,
  SlideUrlOptions,
  SubmitOptions,
  ViewOptions,
  WaitBatchOptions,
  WaitFitOptions,
  WaitOptions,
  Which,
} from "./client.js";
export { OviductConnectionError, OviductError } from "./errors.js";
export type { EventSourceClass, EventSourceLike } from "./events.js";
export { Sections } from "./sections.js";
export type { Ring, Section, SectionEntry, SectionsHeader } from "./sections.js";
export type { components, operations, paths } from "./schema.js";
export type * from "./types.js";
