// Number of a batch's models by state.
import type { Batch, Status } from "oviduct-client";

const ORDER: readonly Status[] = ["succeeded", "running", "queued", "failed", "cancelled"];

export function Counts({ counts }: { counts: Batch["counts"] }) {
  const present = ORDER.filter((status) => counts[status] > 0);
  return (
    <div class="counts">
      <div class="counts-bar" aria-hidden="true">
        {present.map((status) => <span key={status} class={`counts-${status}`} style={{ flexGrow: counts[status] }} />)}
      </div>
      <ul class="small num">
        {present.map((status) => (
          <li key={status}><span class={`counts-dot counts-${status}`} aria-hidden="true" /> {counts[status]} {status}</li>
        ))}
      </ul>
    </div>
  );
}

export function batchTitle({ counts }: Batch): string {
  return counts.total === 1 ? "Study of 1 model" : `Study of ${counts.total} models`;
}

/** True if some models of the batch have not ended. */
export function isOpen({ counts }: Batch): boolean {
  return counts.queued + counts.running > 0;
}
