// What has come: the last message of each topic, when it came, and the histories that strips are drawn from.

import { History } from "./history.js";
import { ESTIMATE, keptAs, staleMs, STRIPS } from "./quantities.js";
import { fieldsOf } from "./systems.js";

export const WINDOW_S = 10;
const GAP_S = 2;

const DRAWN = STRIPS.flatMap(({ names }) => names);
const STATE = DRAWN.filter((name) => ESTIMATE[name].uncertain);
const HEALTH = DRAWN.filter((name) => !ESTIMATE[name].uncertain);
const TRUTH = Object.keys(ESTIMATE).filter((name) => ESTIMATE[name].truth === "rig/truth");
export const TURN = ["x", "y", "z", "w"].map((part) => `quat ${part}`); // of a body in space
export const SD = "sd ";

export class Store {
  #latest = new Map();
  #cameAt = new Map();

  constructor() {
    const rows = WINDOW_S * 100 + 100;
    this.estimates = new History([...STATE, ...HEALTH, ...STATE.map((name) => SD + name)], rows, GAP_S);
    this.truths = new History([...TRUTH, ...TURN], rows, GAP_S);
    this.palmAt = -Infinity; // when palmd was heard last, performance.now()
  }

  /** One message, at `now` (ms). */
  take(said, as, now) {
    const [topic, fields] = [keptAs(said), fieldsOf(said, as)];
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

  /** How long ago (ms) a topic was heard last. */
  age(topic, now) {
    return now - (this.#cameAt.get(topic) ?? -Infinity);
  }

  /** Whether what there is to see is old. */
  stale(now) {
    return now - this.palmAt > staleMs("palm/estimate");
  }

  /** Whether an emulated rig tells the truth at the moment. */
  truthful(now) {
    return this.age("rig/truth", now) < 2 * staleMs("rig/truth") && this.has("rig/object");
  }

  /** Whether what comes is a recorded run. */
  replayed(now) {
    return this.age("replay/run", now) < staleMs("replay/run");
  }

  #takeEstimate(fields) {
    const known = fields.valid ? (name) => fields[name] ?? NaN : () => NaN;
    const sd = fields.valid ? (name) => fields.sd?.[name] ?? NaN : () => NaN;
    this.estimates.add(seconds(fields), [...STATE.map(known), ...HEALTH.map((name) => fields[name] ?? NaN),
      ...STATE.map(sd)]);
  }
}

/** The tick of a message (s, the machine's monotonic clock). */
export function seconds(fields) {
  return fields.mono_ns * 1e-9;
}
