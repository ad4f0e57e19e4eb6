// Search in ascending numbers.

/** Index of the lower neighbour of a value; the first or last interval for values outside. */
export function intervalAt(ascending: ArrayLike<number>, value: number): number {
  let [low, high] = [0, ascending.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (ascending[middle]! <= value) low = middle;
    else high = middle;
  }
  return low;
}

/** Index of the number nearest to a value. */
export function nearestIndex(ascending: ArrayLike<number>, value: number): number {
  const low = intervalAt(ascending, value);
  const high = Math.min(low + 1, ascending.length - 1);
  return value - ascending[low]! <= ascending[high]! - value ? low : high;
}
