/** Calls that run at the same time. */
const AT_ONCE = 3;

/** Does something with each, a few at a time; gives those that failed, and why. */
export async function settle<T>(all: readonly T[], what: (one: T) => Promise<void>): Promise<{ one: T; error: unknown }[]> {
  const rest = all.values();
  const failed: { one: T; error: unknown }[] = [];
  const work = async () => {
    for (const one of rest) await what(one).catch((error: unknown) => failed.push({ one, error }));
  };
  await Promise.all(Array.from({ length: AT_ONCE }, work));
  return failed;
}
