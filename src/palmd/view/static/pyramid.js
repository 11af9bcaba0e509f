// Fields over a whole run in bounded memory: ever longer and coarser levels of least and largest values.

import { History } from "./history.js";

const LEVELS = [ // width of a bucket (s), how many: 5 minutes, an hour, a day
  { width: 0.1, count: 3000 },
  { width: 1, count: 3600 },
  { width: 10, count: 8640 },
];
const POINTS_MOST = 1500; // in a picture: about one a pixel
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

  /** The first time that is kept (s), NaN before there is one. */
  get oldest() {
    return Math.min(...this.#levels.map(({ oldest }) => oldest).filter(Number.isFinite), Infinity);
  }

  /** What a picture from `from` to `to` (s) shows: {times, values(name, scale)}, from the finest level that reaches it. */
  cut(from, to) {
    const [begin, fine] = [Math.max(from, this.oldest), this.#levels.filter(({ width }) => (to - from) / width <= POINTS_MOST)];
    const level = fine.find(({ width, oldest }) => oldest <= begin + width) ?? fine.at(-1) ?? this.#levels.at(-1);
    return level.cut(from, to);
  }
}

/** Buckets of one width: the least and the largest value of each column. */
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

  /** Nothing came for a while: curves have a gap from `t` (s) on. */
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

  /** The bucket so far as a row, in place of what it was before. */
  #flush() {
    const t = this.#bucket * this.width;
    if (this.#history.newest === t) this.#history.drop();
    this.#history.add(t, [...this.#least, ...this.#largest]);
  }

  /** Two points a bucket, and those of the bucket that is being filled. */
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
