/** Maximum number of concurrent calls. */
const AT_ONCE = 3;

/** Calls `what` for each item, a few at a time; returns the failed items with their errors. */
export async function settle<T>(all: readonly T[], what: (one: T) => Promise<void>): Promise<{ one: T; error: unknown }[]> {
  const rest = all.values();
  const failed: { one: T; error: unknown }[] = [];
  const work = async () => {
    for (const one of rest) await what(one).catch((error: unknown) => failed.push({ one, error }));
  };
  await Promise.all(Array.from({ length: AT_ONCE }, work));
  return failed;
}
