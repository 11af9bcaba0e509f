// The received data: last message of each topic with its time, and the histories for the strips.

import { History } from "./history.js";
import { Pyramid } from "./pyramid.js";
import { ESTIMATE, keptAs, LISTED, staleMs, STRIPS, withStandardNames } from "./quantities.js";
import { fieldsOf } from "./systems.js";

// Every tick is kept for this time, older data as minima and maxima
const KEPT_S = 12;
const GAP_S = 2;

const DRAWN = STRIPS.flatMap(({ names }) => names);
const STATE = DRAWN.filter((name) => ESTIMATE[name].uncertain);
const IN_LISTS = new Set(LISTED.map(({ name }) => name));
const HEALTH = DRAWN.filter((name) => !ESTIMATE[name].uncertain && !IN_LISTS.has(name));
const TRUTH = Object.keys(ESTIMATE).filter((name) => ESTIMATE[name].truth === "rig/truth");
// Orientation of a body in space
export const TURN = ["x", "y", "z", "w"].map((part) => `quat ${part}`);
export const SD = "sd ";

export class Store {
  #latest = new Map();
  #cameAt = new Map();

  constructor() {
    const rows = KEPT_S * 100;
    const columns = [...STATE, ...HEALTH, ...LISTED.map(({ name }) => name), ...STATE.map((name) => SD + name)];
    this.estimates = new History(columns, rows, GAP_S);
    this.run = new Pyramid(columns);
    this.truths = new History([...TRUTH, ...TURN], rows, GAP_S);
    this.palmAt = -Infinity; // time of the last message of palmd, performance.now()
  }

  /** Stores a message received at `now` (ms). */
  take(topicName, message, now) {
    const [topic, fields] = [keptAs(topicName), fieldsOf(topicName, withStandardNames(topicName, message))];
    this.#latest.set(topic, fields);
    this.#cameAt.set(topic, now);
    if (topic.startsWith("palm/")) this.palmAt = now;
    if (topic === "palm/estimate") this.#takeEstimate(fields);
    if (topic === "rig/truth") {
      this.truths.add(seconds(fields), [...TRUTH.map((name) => fields[name]), ...TURN.map((_, i) => fields.quat_xyzw?.[i])]);
    }
  }

  /** The last message of a topic, an empty map before the first. */
  get(topic) {
    return this.#latest.get(topic) ?? {};
  }

  has(topic) {
    return this.#latest.has(topic);
  }

  /** An element of a list in a message, NaN if missing. */
  listed({ topic, list, index }) {
    return this.get(topic)[list]?.[index] ?? NaN;
  }

  /** The data for a picture from `from` to `to` (s): {times, values(name, scale), whole}; `whole`: every tick is available. */
  cut(from, to, stride) {
    if (!(this.estimates.oldest <= Math.max(from, this.run.oldest) + 0.5)) return this.run.cut(from, to);
    const [first, last] = this.estimates.rows(from, to);
    const every = (column) => column.filter((_, i) => (first + i) % stride === 0); // always the same rows
    return {
      times: every(this.estimates.slice(null, first, last)),
      values: (name, scale) => every(this.estimates.slice(name, first, last, scale)),
      whole: true,
    };
  }

  /** The age (ms) of a topic's last message. */
  age(topic, now) {
    return now - (this.#cameAt.get(topic) ?? -Infinity);
  }

  /** Whether the estimate is too old. */
  stale(now) {
    return now - this.palmAt > staleMs("palm/estimate");
  }

  /** Whether an emulated rig currently publishes the truth. */
  truthful(now) {
    return this.age("rig/truth", now) < 2 * staleMs("rig/truth") && this.has("rig/object");
  }

  /** Whether the messages are a replay of a recorded run. */
  replayed(now) {
    return this.age("replay/run", now) < staleMs("replay/run");
  }

  #takeEstimate(fields) {
    const known = fields.valid ? (name) => fields[name] ?? NaN : () => NaN;
    const sd = fields.valid ? (name) => fields.sd?.[name] ?? NaN : () => NaN;
    const row = [...STATE.map(known), ...HEALTH.map((name) => fields[name] ?? NaN),
      ...LISTED.map((each) => this.listed(each)), ...STATE.map(sd)];
    this.estimates.add(seconds(fields), row);
    this.run.add(seconds(fields), row);
  }
}

/** The time of a message (s, monotonic clock). */
export function seconds(fields) {
  return fields.mono_ns * 1e-9;
}
