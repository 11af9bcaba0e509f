// Fields over a whole run in bounded memory: levels of minima and maxima with increasing length and bucket width.

import { History } from "./history.js";

const LEVELS = [ // width (s) and number of buckets: 5 minutes, an hour, a day
  { width: 0.1, count: 3000 },
  { width: 1, count: 3600 },
  { width: 10, count: 8640 },
];
const MAX_POINTS = 1500; // points in a picture: about one per pixel
const GAP_S = 2;

export class Pyramid {
  #levels;
  #newest = NaN;

  /** `names` of the columns. */
  constructor(names) {
    this.#levels = LEVELS.map(({ width, count }) => new Level(names, width, count));
  }

  /** Adds a row: time (s) and values in the order of the names. */
  add(t, values) {
    if (t < this.#newest) for (const level of this.#levels) level.clear();
    if (t > this.#newest + GAP_S) for (const level of this.#levels) level.interrupt(this.#newest);
    this.#newest = t;
    for (const level of this.#levels) level.add(t, values);
  }

  /** The oldest stored time (s), Infinity without one. */
  get oldest() {
    return Math.min(...this.#levels.map(({ oldest }) => oldest).filter(Number.isFinite), Infinity);
  }

  /** The data for a picture from `from` to `to` (s): {times, values(name, scale)}, from the finest level that covers it. */
  cut(from, to) {
    const [begin, fine] = [Math.max(from, this.oldest), this.#levels.filter(({ width }) => (to - from) / width <= MAX_POINTS)];
    const level = fine.find(({ width, oldest }) => oldest <= begin + width) ?? fine.at(-1) ?? this.#levels.at(-1);
    return level.cut(from, to);
  }
}

/** Buckets of one width: minimum and maximum of each column. */
class Level {
  #history;
  #least;
  #largest;
  #bucket = NaN;

  constructor(names, width, count) {
    this.width = width;
    this.#history = new History([...names, ...names.map((name) => `${name} most`)], count, Infinity, Float32Array);
    this.#least = new Float64Array(names.length);
    this.#largest = new Float64Array(names.length);
  }

  get oldest() {
    return this.#history.oldest;
  }

  clear() {
    this.#history.clear();
    this.#bucket = NaN;
  }

  /** Inserts a gap in the curves at `t` (s). */
  interrupt(t) {
    if (Number.isNaN(this.#bucket)) return;
    this.#flush();
    this.#history.add(t, new Array(2 * this.#least.length).fill(NaN));
    this.#bucket = NaN;
  }

  add(t, values) {
    const bucket = Math.floor(t / this.width);
    if (bucket !== this.#bucket) {
      if (!Number.isNaN(this.#bucket)) this.#flush();
      this.#bucket = bucket;
      this.#least.fill(NaN);
      this.#largest.fill(NaN);
    }
    for (let i = 0; i < values.length; i++) {
      const value = values[i];
      if (!(value >= this.#least[i])) this.#least[i] = Number.isNaN(value) ? this.#least[i] : value;
      if (!(value <= this.#largest[i])) this.#largest[i] = Number.isNaN(value) ? this.#largest[i] : value;
    }
  }

  /** Stores the current bucket as a row, replacing its earlier version. */
  #flush() {
    const t = this.#bucket * this.width;
    if (this.#history.newest === t) this.#history.drop();
    this.#history.add(t, [...this.#least, ...this.#largest]);
  }

  /** Two points per bucket, including the current one. */
  cut(from, to) {
    if (!Number.isNaN(this.#bucket)) this.#flush();
    const [first, last] = this.#history.rows(from - this.width, to + this.width);
    const times = this.#history.slice(null, first, last).flatMap((t) => [t, t + this.width / 2]);
    const values = (name, scale) => {
      const [least, most] = [this.#history.slice(name, first, last, scale), this.#history.slice(`${name} most`, first, last, scale)];
      return least.flatMap((value, i) => [value, most[i]]);
    };
    return { times, values };
  }
}
