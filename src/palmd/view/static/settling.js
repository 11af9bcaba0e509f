// Whether the accuracy still changes while the palms stand: medians, for single late readings widen it for a moment.

const WINDOW_S = 10; // a smoother beside the loop answers every few seconds
const SHARE = 0.05;

export class Settling {
  #seen = []; // {t, value} of the last ten seconds
  #begun = NaN;

  /** Begins anew. */
  reset() {
    this.#seen = [];
    this.#begun = NaN;
  }

  /** `value` as seen at `t` (s); what is no number counts for nothing. */
  take(value, t) {
    if (!Number.isFinite(value)) return;
    if (Number.isNaN(this.#begun)) this.#begun = t;
    this.#seen.push({ t, value });
    this.#seen = this.#seen.filter((each) => each.t > t - WINDOW_S);
  }

  /** The median of the last five seconds, NaN before there is one. */
  get value() {
    return this.#median((t, last) => t > last - WINDOW_S / 2);
  }

  /** Whether that differs by at most 5 % from the median of the five seconds before. */
  get steady() {
    const last = this.#seen.at(-1)?.t ?? NaN;
    if (!(last - this.#begun >= 0.95 * WINDOW_S)) return false;
    const before = this.#median((t) => t <= last - WINDOW_S / 2);
    return Math.abs(this.value - before) <= SHARE * before;
  }

  #median(counts) {
    const last = this.#seen.at(-1)?.t;
    const values = this.#seen.filter(({ t }) => counts(t, last)).map(({ value }) => value).sort((a, b) => a - b);
    return values[values.length >> 1] ?? NaN;
  }
}
