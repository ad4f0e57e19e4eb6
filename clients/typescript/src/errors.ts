import type { Fault, Problem, ProblemSlug, ProblemType } from "./types.js";

const PREFIX = "urn:oviduct:problem:";

/** The service refused a request or failed; contains the problem (RFC 9457) in its response. */
export class OviductError extends Error {
  override readonly name = "OviductError";
  /** Status of the response. */
  readonly status: number;
  /**
   * Stable type of the problem; `about:blank` for another response, such as a proxy's error page.
   */
  readonly type: ProblemType | "about:blank";
  /** Title, equal for all problems of the type. */
  readonly title: string;
  /** Description of this occurrence. */
  readonly detail: string;
  /** Faults of the request, each with its place; empty if the problem has none. */
  readonly errors: readonly Fault[];
  /** Id of the request in the logs of the service. */
  readonly requestId: string | undefined;
  /** Seconds to wait before a retry. */
  readonly retryAfter: number | undefined;
  /** The whole problem, including members of its type such as `limit` or `line`. */
  readonly problem: Problem | undefined;

  constructor(response: Response, problem?: Problem) {
    const title = problem?.title ?? (response.statusText || `status ${response.status}`);
    const detail = problem?.detail ?? `The answer has the status ${response.status} and is not a problem.`;
    const errors = faults(problem?.errors);
    super(`${title}: ${detail}${errors.map((fault) => `\n- ${place(fault)}${fault.detail}`).join("")}`);
    this.status = response.status;
    this.type = problem?.type ?? "about:blank";
    this.title = title;
    this.detail = detail;
    this.errors = errors;
    this.requestId = problem?.request_id ?? response.headers.get("x-request-id") ?? undefined;
    this.retryAfter = seconds(response.headers.get("retry-after"));
    this.problem = problem;
  }

  /**
   * True if the problem has one of these types, without their prefix.
   *
   * Example: `error.is("unauthorized", "forbidden")`.
   */
  is(...slugs: ProblemSlug[]): boolean {
    return slugs.some((slug) => this.type === PREFIX + slug);
  }

  /** Reads the problem in a response. */
  static async of(response: Response): Promise<OviductError> {
    const isProblem = response.headers.get("content-type")?.startsWith("application/problem+json") ?? false;
    if (isProblem) {
      return new OviductError(response, (await response.json()) as Problem);
    }
    await response.body?.cancel();
    return new OviductError(response);
  }
}

/**
 * There was no complete response: the service is unreachable, too slow, or closed the connection.
 *
 * `cause` is the reason.
 */
export class OviductConnectionError extends Error {
  override readonly name = "OviductConnectionError";
}

/** The well-formed faults; a proxy may send a problem with other members. */
function faults(errors: unknown): Fault[] {
  return Array.isArray(errors) ? errors.filter(isFault) : [];
}

function isFault(value: unknown): value is Fault {
  if (typeof value !== "object" || value === null) return false;
  const { detail, pointer, parameter, header } = value as Record<string, unknown>;
  return typeof detail === "string" && [pointer, parameter, header].every((at) => typeof (at ?? "") === "string");
}

function place(fault: Fault): string {
  const where = fault.pointer ?? fault.parameter ?? fault.header;
  return where ? `${where}: ` : "";
}

/** Seconds of `Retry-After`, which may also be a date. */
function seconds(header: string | null): number | undefined {
  if (header === null) return undefined;
  if (/^\d+$/.test(header)) return Number(header);
  const at = Date.parse(header);
  return Number.isNaN(at) ? undefined : Math.max(0, (at - Date.now()) / 1000);
}
