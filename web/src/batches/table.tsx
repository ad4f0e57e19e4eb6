// The models of a study, one per row.
import { useState } from "preact/hooks";
import type { Status, Table } from "oviduct-client";
import { growth } from "../growing/words.ts";
import { shortId } from "../list/twins.ts";
import { state } from "../models.ts";
import { href, route, setQuery } from "../router.ts";
import { StatusBadge } from "../ui/widgets.tsx";
import { readOrder, sorted, text, writeOrder, type Cell, type Column } from "./columns.ts";

/** Number of rows that are shown at first. */
const ROWS = 200;

/** The first of `columns` is the seed, which links to the model. */
export function Models({ table, columns }: { table: Table; columns: [Column, ...Column[]] }) {
  const [all, setAll] = useState(false);
  const order = readOrder(route.value.query.get("sort"));
  const rows = sorted(table, order);
  const [id, status] = [table.columns.indexOf("id"), table.columns.indexOf("status")];
  const repeated = new Set(rows.map((row) => text(row[columns[0].at]))).size < rows.length;
  const sortBy = (key: string) => {
    const query = new URLSearchParams(route.peek().query);
    query.set("sort", writeOrder({ key, descending: order?.key === key && !order.descending }));
    setQuery(query);
  };
  const [seed, ...others] = columns;
  const headers: Pick<Column, "key" | "title" | "unit">[] = [seed, { key: "status", title: "Status" }, ...others];
  return (
    <section aria-label="Models of this study">
      <div class="study-table card" tabIndex={0} role="group" aria-label="Table of models">
        <table class="num">
          <thead>
            <tr>
              {headers.map(({ key, title, unit }) => (
                <th key={key} scope="col" aria-sort={order?.key !== key ? undefined : order.descending ? "descending" : "ascending"}>
                  <button type="button" onClick={() => sortBy(key)}>
                    {title}{unit && <span class="soft"> {unit}</span>}
                    {order?.key === key && <span aria-hidden="true"> {order.descending ? "↓" : "↑"}</span>}
                  </button>
                </th>
              ))}
            </tr>
          </thead>
          <tbody>
            {rows.slice(0, all ? undefined : ROWS).map((row) => (
              <tr key={text(row[id])}>
                <th scope="row"><a href={href(["models", text(row[id])])} aria-label={`Model with seed ${text(row[seed.at])}${repeated ? `, ${shortId(text(row[id]))}` : ""}`}>{text(row[seed.at])}</a></th>
                <td><LiveStatus id={text(row[id])} read={text(row[status]) as Status} /></td>
                {others.map(({ key, at }) => <td key={key}>{figure(row[at])}</td>)}
              </tr>
            ))}
          </tbody>
        </table>
      </div>
      {!all && rows.length > ROWS && <p class="row study-more"><button type="button" class="button" onClick={() => setAll(true)}>Show all {rows.length} models</button></p>}
    </section>
  );
}

/** The status from events, because the table is read less often. */
function LiveStatus({ id, read }: { id: string; read: Status }) {
  const model = state(id).value;
  return (
    <>
      <StatusBadge status={model?.status ?? read} />
      {model?.status === "running" && <span class="small soft"> {growth(model.progress)}</span>}
    </>
  );
}

/** Text of a measure; models of a study may differ only in the fourth digit. */
function figure(cell: Cell | undefined): string {
  return typeof cell === "number" ? cell.toLocaleString("en", { maximumSignificantDigits: Math.abs(cell) < 1000 ? 4 : 7 }) : text(cell);
}
