// The last seconds of some fields as contiguous columns.

/** Rows of numbers in time order; NaN for no value. A jump of the clock clears the history. */
export class History {
  #columns;
  #capacity;
  #gap;

  /** `names` of the columns besides time; at least `capacity` rows are kept; `gap` s without a row clear the history. */
  constructor(names, capacity, gap, Values = Float64Array) {
    this.names = names;
    this.start = 0;
    this.end = 0;
    this.#capacity = capacity;
    this.#gap = gap;
    this.#columns = [new Float64Array(2 * capacity), ...names.map(() => new Values(2 * capacity))];
  }

  /** Removes all rows. */
  clear() {
    this.start = this.end = 0;
  }

  /** Removes the newest row. */
  drop() {
    this.end -= 1;
  }

  /** The time of the oldest row (s), NaN without one. */
  get oldest() {
    return this.end > this.start ? this.#columns[0][this.start] : NaN;
  }

  /** The time of the newest row (s), NaN without one. */
  get newest() {
    return this.end > this.start ? this.#columns[0][this.end - 1] : NaN;
  }

  /** Adds a row: time (s) and values in the order of `names`. */
  add(t, values) {
    if (t < this.newest || t > this.newest + this.#gap) this.start = this.end = 0;
    if (this.end === 2 * this.#capacity) {
      for (const column of this.#columns) column.copyWithin(0, this.#capacity);
      this.start -= this.#capacity;
      this.end -= this.#capacity;
    }
    this.#columns[0][this.end] = t;
    for (let i = 0; i < values.length; i++) this.#columns[i + 1][this.end] = values[i];
    this.end += 1;
    this.start = Math.max(this.start, this.end - this.#capacity);
  }

  /** The times from `since` (s) on, every `stride`-th. */
  times(since, stride) {
    const found = [];
    const times = this.#columns[0];
    for (let i = this.#first(since, stride); i < this.end; i += stride) found.push(times[i]);
    return found;
  }

  /** A column from `since` (s) on, every `stride`-th, times `scale`; null for no value. */
  values(name, since, stride, scale) {
    const found = [];
    const column = this.#columns[this.names.indexOf(name) + 1];
    for (let i = this.#first(since, stride); i < this.end; i += stride) {
      found.push(Number.isNaN(column[i]) ? null : column[i] * scale);
    }
    return found;
  }

  /** A column interpolated at increasing `times`, times `scale`; null outside this history. */
  valuesAt(times, name, scale) {
    const [own, column] = [this.#columns[0], this.#columns[this.names.indexOf(name) + 1]];
    let i = this.start;
    return times.map((t) => {
      while (i + 1 < this.end && own[i + 1] < t) i += 1;
      if (i + 1 >= this.end || t < own[i]) return null;
      const share = (t - own[i]) / (own[i + 1] - own[i]);
      return (column[i] + share * (column[i + 1] - column[i])) * scale;
    });
  }

  /** The row of the last time before `t`, and the fraction of the interval to the next row: [row, 0…1]; null for none. */
  place(t) {
    const times = this.#columns[0];
    for (let i = this.end - 2; i >= this.start; i--) {
      if (times[i] <= t) return t <= times[i + 1] ? [i, (t - times[i]) / (times[i + 1] - times[i])] : null;
    }
    return null;
  }

  /** A column's value at a place between two rows. */
  between(name, [row, share]) {
    const column = this.#columns[this.names.indexOf(name) + 1];
    return column[row] + share * (column[row + 1] - column[row]);
  }

  /** The rows from `from` to `to` (s): [first, one past the last]. */
  rows(from, to) {
    return [this.#search(from), this.#search(to)];
  }

  /** A range of a column, times `scale`; the times if `name` is null; null for no value. */
  slice(name, first, last, scale = 1) {
    const column = this.#columns[name === null ? 0 : this.names.indexOf(name) + 1];
    return Array.from(column.subarray(first, last), (value) => (Number.isNaN(value) ? null : value * scale));
  }

  /** The first row at or after `t` (s). */
  #search(t) {
    let [low, high] = [this.start, this.end];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.#columns[0][middle] < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  #first(since, stride) {
    const times = this.#columns[0];
    let i = this.end;
    while (i > this.start && times[i - 1] >= since) i -= 1;
    return Math.ceil(i / stride) * stride; // always the same rows, so that curves do not flicker
  }
}
