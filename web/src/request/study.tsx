// Several models in one request: seeds and varied parameters.
import { Icon } from "../ui/widgets.tsx";
import { BLANK, RANGE, variedFrom, variedPointer, type Form, type Varied } from "./form.ts";
import { controlId, controlOf, Faults, Field } from "./inputs.tsx";
import { groupsOf, type Parameter } from "./parameters.ts";
import { isSchedule } from "./schedule.ts";
import { catalogue, change, form, parameters, varied } from "./state.ts";

export function StudyFields() {
  const { design } = form.value;
  return (
    <section class="card stack" aria-labelledby="study-title">
      <h2 id="study-title">Study</h2>
      <SeedFields />
      <h3>Varied parameters</h3>
      {varied.value.length === 0 && <p class="soft">None: the models differ by their seeds only.</p>}
      {varied.value.map((entry) => (
        <VariedFields key={entry.pointer} varied={entry} parameter={parameters.value.find(({ pointer }) => pointer === entry.pointer)!} />
      ))}
      <AddVaried />
      {varied.value.length > 0 && (
        <div class="columns">
          <div class="field">
            <label for="design">Design</label>
            <select id="design" value={design} onChange={({ currentTarget }) => change({ design: currentTarget.value as Form["design"] })}>
              <option value="grid">Grid: every combination of the values</option>
              <option value="lhs">Latin hypercube: random points, evenly spread</option>
            </select>
          </div>
          {design === "lhs" && (
            <Field pointer="/vary/samples" title="Points">
              <input {...controlOf("/vary/samples", false)} inputMode="numeric" autocomplete="off" value={form.value.samples} onInput={({ currentTarget }) => change({ samples: currentTarget.value })} />
            </Field>
          )}
        </div>
      )}
    </section>
  );
}

function SeedFields() {
  const { seeds, seedCount, seedList } = form.value;
  const each = varied.value.length > 0 ? " of each point" : "";
  return (
    <div class="columns">
      <div class="field">
        <label for="seeds">Seeds</label>
        <select id="seeds" value={seeds} onChange={({ currentTarget }) => change({ seeds: currentTarget.value as Form["seeds"] })}>
          <option value="one">One, drawn by the service</option>
          <option value="drawn">Several, drawn by the service</option>
          <option value="given">These</option>
        </select>
        {seeds === "one" && varied.value.length > 0 && <div class="hint">All points have the same seed: they differ by the varied parameters alone.</div>}
      </div>
      {seeds === "drawn" && (
        <Field pointer="/count" title={`Models${each}`}>
          <input {...controlOf("/count", false)} inputMode="numeric" autocomplete="off" value={seedCount} onInput={({ currentTarget }) => change({ seedCount: currentTarget.value })} />
        </Field>
      )}
      {seeds === "given" && (
        <Field pointer="/seeds" title={`Seeds${each}`} hint="Numbers and ranges, such as 1..10, 42">
          <input {...controlOf("/seeds")} autocomplete="off" value={seedList} onInput={({ currentTarget }) => change({ seedList: currentTarget.value })} />
        </Field>
      )}
    </div>
  );
}

function AddVaried() {
  const taken = new Set(varied.value.map(({ pointer }) => pointer));
  const free = parameters.value.filter(({ pointer, kind }) => !taken.has(pointer) && kind.type !== "points");
  const add = (pointer: string) => {
    const parameter = free.find((other) => other.pointer === pointer);
    if (!parameter) return;
    const { seeds, seedCount } = form.value;
    // By default, points share a seed, so they differ only in the varied parameter.
    const asked = taken.size > 0 || seeds !== BLANK.seeds || seedCount !== BLANK.seedCount;
    change({ varied: [...form.value.varied, variedFrom(parameter)], ...(asked ? {} : { seeds: "one" }) });
  };
  return (
    <label class="row">
      <span class="visually-hidden">Vary a parameter</span>
      <select
        value=""
        onChange={({ currentTarget }) => {
          add(currentTarget.value);
          currentTarget.value = "";
        }}
      >
        <option value="">Vary {taken.size > 0 ? "another" : "a"} parameter …</option>
        {groupsOf(catalogue.value!.schema, free).map(({ name, title, parameters }) => (
          <optgroup key={name} label={title}>
            {parameters.map(({ pointer, title }) => (
              <option key={pointer} value={pointer}>{title}</option>
            ))}
          </optgroup>
        ))}
      </select>
    </label>
  );
}

function VariedFields({ varied, parameter }: { varied: Varied; parameter: Parameter }) {
  const { title, unit, kind } = parameter;
  const pointer = variedPointer(varied.pointer);
  const set = (part: Partial<Varied>) => change({ varied: form.value.varied.map((other) => (other.pointer === varied.pointer ? { ...other, ...part } : other)) });
  const number = (member: (typeof RANGE)[number], label: string) => (
    <label>
      <span>{label}</span>
      <input
        {...controlOf(variedPointer(varied.pointer, member), false)}
        inputMode="decimal"
        autocomplete="off"
        aria-label={`${label} of ${title}`}
        value={varied[member]}
        onInput={({ currentTarget }) => set({ [member]: currentTarget.value })}
      />
    </label>
  );
  const numeric = kind.type === "number" || kind.type === "schedule";
  return (
    <fieldset class="varied" id={varied.values === "range" ? controlId(pointer) : undefined} tabIndex={-1}>
      <legend>{title}{unit && <span class="soft">, {unit}</span>}</legend>
      <div class="varied-values">
        {numeric && (
          <label>
            <span>Values</span>
            <select value={varied.values} aria-label={`Values of ${title}`} onChange={({ currentTarget }) => set({ values: currentTarget.value as Varied["values"] })}>
              <option value="range">Range</option>
              <option value="list">List</option>
            </select>
          </label>
        )}
        {varied.values === "range" ? (
          <>
            {number("from", "From")}
            {number("to", "To")}
            {form.value.design === "grid" && number("count", "Number of values")}
          </>
        ) : (
          <label class="list">
            <span>List</span>
            <input {...controlOf(pointer, false)} autocomplete="off" aria-label={`List of values of ${title}`} value={varied.list} onInput={({ currentTarget }) => set({ list: currentTarget.value })} />
          </label>
        )}
        <button type="button" class="button-icon" aria-label={`Do not vary ${title}`} onClick={() => change({ varied: form.value.varied.filter((other) => other.pointer !== varied.pointer) })}>
          <Icon name="trash" />
        </button>
      </div>
      <Faults pointer={pointer} title={title} />
      <Faults pointer={variedPointer(varied.pointer, "from")} title="The first value" />
      <Faults pointer={variedPointer(varied.pointer, "to")} title="The last value" />
      <Faults pointer={variedPointer(varied.pointer, "count")} title="The number of values" />
      {overCurve(parameter) && <p class="hint">Each value is constant along the tube and replaces the curve below.</p>}
    </fieldset>
  );
}

function overCurve({ pointer, preset }: Parameter): boolean {
  return isSchedule(form.value.changes[pointer] ?? preset);
}
