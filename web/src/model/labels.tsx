import { href } from "../router.ts";

/** Labels as links to the models that have them. */
export function Labels({ labels }: { labels: Record<string, string> }) {
  const all = Object.entries(labels);
  if (all.length === 0) return null;
  return (
    <ul class="labels" aria-label="Labels">
      {all.map(([name, value]) => (
        <li key={name}>
          <a href={href([], { label: `${name}:${value}` })}>{name}: {value}</a>
        </li>
      ))}
    </ul>
  );
}
