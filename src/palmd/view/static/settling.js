// Whether the accuracy still changes while the palms are at rest; by medians, as single late readings worsen it briefly.

const WINDOW_S = 10; // the fixed-lag smoother answers every few seconds
const SHARE = 0.05;

export class Settling {
  #seen = []; // {t, value} of the last ten seconds
  #start = NaN;

  /** Clears the history. */
  reset() {
    this.#seen = [];
    this.#start = NaN;
  }

  /** Adds `value` at `t` (s); values that are not finite are ignored. */
  take(value, t) {
    if (!Number.isFinite(value)) return;
    if (Number.isNaN(this.#start)) this.#start = t;
    this.#seen.push({ t, value });
    this.#seen = this.#seen.filter((each) => each.t > t - WINDOW_S);
  }

  /** The median of the last five seconds, NaN without values. */
  get value() {
    return this.#median((t, last) => t > last - WINDOW_S / 2);
  }

  /** Whether the median differs by at most 5 % from that of the five seconds before. */
  get steady() {
    const last = this.#seen.at(-1)?.t ?? NaN;
    if (!(last - this.#start >= 0.95 * WINDOW_S)) return false;
    const before = this.#median((t) => t <= last - WINDOW_S / 2);
    return Math.abs(this.value - before) <= SHARE * before;
  }

  #median(counts) {
    const last = this.#seen.at(-1)?.t;
    const values = this.#seen.filter(({ t }) => counts(t, last)).map(({ value }) => value).sort((a, b) => a - b);
    return values[values.length >> 1] ?? NaN;
  }
}
