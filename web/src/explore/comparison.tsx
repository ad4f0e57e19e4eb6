// A model's measures and published values for its organ and species.
import { useSignal } from "@preact/signals";
import { useId } from "preact/hooks";
import { short } from "../ui/format.ts";
import { quantity } from "./quantities.ts";
import type { Comparison } from "./series.ts";

type Compared = Comparison["compared"][number];

/** `7.41 to 9.21`, `at least 5`, `at most 35`, or the value if there is no range. */
export function range({ low, high, value }: Pick<Compared, "low" | "high" | "value">): string {
  if (low != null && high != null) return `${short(low)} to ${short(high)}`;
  if (low != null) return `at least ${short(low)}`;
  if (high != null) return `at most ${short(high)}`;
  return value == null ? "–" : short(value);
}

/** `+0.9 SD`: the deviation from the published mean. */
export function deviation(sd: number | null | undefined): string | undefined {
  if (sd == null) return undefined;
  const size = Math.abs(sd).toFixed(1);
  return `${size === "0.0" ? "±" : sd < 0 ? "−" : "+"}${size} SD`;
}

const VERDICTS: Record<Compared["verdict"], string> = {
  inside: "inside",
  outside: "outside",
  no_range: "no range",
  method_unknown: "method unknown",
  not_measured: "not measured",
  shortened: "shortened by choice",
};
/** Names of regions. The name of a measure of the tube already says so. */
const REGIONS: Record<string, string> = { whole: "whole tube", tube: "" };

export function ComparisonTable({ comparison }: { comparison: Comparison }) {
  const { compared, inside, outside, organ, species, shortened } = comparison;
  if (compared.length === 0) return null;
  return (
    <section class="compared" aria-labelledby="compared">
      <h3 id="compared">Beside published anatomy</h3>
      <p class="soft">
        {inside + outside === 0
          ? `No range is published (${organ}, ${species}).`
          : `${inside} of ${inside + outside} measures with a published range (${organ}, ${species}) ${inside === 1 ? "is" : "are"} inside it.`}
      </p>
      {shortened && <p class="soft">The tube is shortened by choice. {shortened}</p>}
      <div class="compared-scroll">
        <table class="num">
          <thead>
            <tr>
              <th scope="col">Measure and region</th>
              <th scope="col">Model</th>
              <th scope="col">Published</th>
              <th scope="col">Verdict</th>
            </tr>
          </thead>
          <tbody>{compared.map((one, k) => <Row key={k} one={one} />)}</tbody>
        </table>
      </div>
    </section>
  );
}

/** ` (mean 8.31, SD 0.9, n = 100)`: published values in addition to the range. */
function figures({ value, sd, n }: Compared): string {
  const parts = [value != null && `${sd == null ? "value" : "mean"} ${short(value)}`, sd != null && `SD ${short(sd)}`, n != null && `n = ${n}`];
  const known = parts.filter((part) => part !== false);
  return known.length > 0 ? ` (${known.join(", ")})` : "";
}

/** One measure; clicking its name shows its source. */
function Row({ one }: { one: Compared }) {
  const open = useSignal(false);
  const id = useId();
  const { title, unit } = quantity(one.quantity);
  const far = deviation(one.deviation_sd);
  return (
    <>
      <tr>
        <th scope="row">
          <button type="button" aria-expanded={open.value} aria-controls={id} title={`${one.source} [${one.confidence}]`} onClick={() => (open.value = !open.value)}>
            {title}
          </button>
          <span class="compared-region soft">{[REGIONS[one.region] ?? one.region, unit].filter(Boolean).join(", ")}</span>
        </th>
        <td>{one.measured == null ? "–" : short(one.measured)}</td>
        <td>{range(one)}</td>
        <td>
          <span class={`verdict-${one.verdict}`}>{VERDICTS[one.verdict]}</span>
          {far && <span class="compared-far soft">{far}</span>}
        </td>
      </tr>
      <tr id={id} class="compared-source" hidden={!open.value}>
        <td colSpan={4}>
          <p>{one.published}{figures(one)}</p>
          <p>{one.source}</p>
          <p class="soft">How it was learnt: {one.confidence}.</p>
        </td>
      </tr>
    </>
  );
}
