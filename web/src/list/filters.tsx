// The conditions above the list.
import { useId } from "preact/hooks";
import { usePresets } from "../model/presets.ts";
import { href, setQuery } from "../router.ts";
import { Icon, toast } from "../ui/widgets.tsx";
import { isEmpty, STATUSES, withLabel, writeFilter, type Filter, type Period } from "./filter.ts";

const WITHIN: Record<Period, string> = { hour: "Last hour", day: "Last day", week: "Last week", month: "Last 30 days" };

export function Filters({ filter }: { filter: Filter }) {
  const presets = usePresets();
  const field = useId();
  const change = (changed: Partial<Filter>) => setQuery(writeFilter({ ...filter, ...changed }));
  const addLabel = (event: SubmitEvent) => {
    event.preventDefault();
    const input = (event.currentTarget as HTMLFormElement).elements.namedItem("label") as HTMLInputElement;
    const label = input.value.trim().replace(/^([^:]+):\s+/, "$1:");
    if (label.indexOf(":") < 1) return toast("A label is searched as name:value.", "error");
    change({ labels: withLabel(filter.labels, label) });
    input.value = "";
  };
  return (
    <div class="filters" role="search" aria-label="Filter models">
      <select aria-label="Status" value={filter.status ?? ""} onChange={(event) => change({ status: STATUSES.find((name) => name === event.currentTarget.value) })}>
        <option value="">Any status</option>
        {STATUSES.map((status) => <option key={status} value={status}>{status[0]!.toUpperCase() + status.slice(1)}</option>)}
      </select>
      <select aria-label="Preset" value={filter.preset ?? ""} onChange={(event) => change({ preset: event.currentTarget.value || undefined })}>
        <option value="">Any preset</option>
        {presets.map(({ name, title }) => <option key={name} value={name}>{title}</option>)}
      </select>
      <select aria-label="Time" value={filter.within ?? ""} onChange={(event) => change({ within: (event.currentTarget.value || undefined) as Period | undefined })}>
        <option value="">Any time</option>
        {Object.entries(WITHIN).map(([within, text]) => <option key={within} value={within}>{text}</option>)}
      </select>
      <form onSubmit={addLabel}>
        <label class="visually-hidden" for={field}>Label, as name:value</label>
        <input id={field} name="label" type="search" placeholder="Label, as name:value" autocomplete="off" />
      </form>
      {filter.labels.map((label) => (
        <Chip key={label} text={label} onRemove={() => change({ labels: filter.labels.filter((other) => other !== label) })} />
      ))}
      {filter.batch && <Chip text="One study" onRemove={() => change({ batch: undefined })} />}
      {!isEmpty(filter) && <a href={href([])}>Show all</a>}
    </div>
  );
}

function Chip({ text, onRemove }: { text: string; onRemove: () => void }) {
  return (
    <button type="button" class="chip" aria-label={`Remove the condition ${text}`} onClick={onRemove}>
      {text} <Icon name="close" />
    </button>
  );
}
