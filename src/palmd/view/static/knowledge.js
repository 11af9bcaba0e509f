// Accuracy of the estimate, and the current activity as text with its reason. Pure.

import { inSpace } from "./surface.js";
import { truthDifference, truthDifferenceInSpace, truthAt, turnAt } from "./truth.js";

/** Upper limits of the outline's classes of standard deviation (m); beyond the last it is hardly known. */
export const CLASSES_M = [10e-6, 30e-6, 100e-6, 300e-6];

/** The class of a standard deviation (m): 0 for the best, CLASSES_M.length for the worst. */
export function classOf(sd) {
  const found = CLASSES_M.findIndex((end) => sd <= end);
  return found < 0 ? CLASSES_M.length : found;
}

/** Median and largest of `values` where `counted`, NaN for none. */
export function spread(values, counted) {
  const some = values.filter((_, i) => counted[i]).sort((a, b) => a - b);
  return { typical: some.length ? some[some.length >> 1] : NaN, worst: some.at(-1) ?? NaN };
}

/** Standard deviation (m) of the outline where touched, median and largest; NaN unless the estimate is valid. */
export function accuracy(store) {
  const shape = store.get("palm/shape");
  if (!store.get("palm/estimate").valid || !shape.h_m) return { typical: NaN, worst: NaN };
  return spread(shape.h_sd_m, shape.touched);
}

/** Error (m) of the outline to the emulated rig's truth where touched, median and largest; NaN without truth. */
export function error(store, now) {
  const [estimate, shape] = [store.get("palm/estimate"), store.get("palm/shape")];
  if (!estimate.valid || !shape.h_m || !store.truthful(now)) return { typical: NaN, worst: NaN };
  if (inSpace(estimate)) {
    const errors = truthDifferenceInSpace(shape, store.get("rig/object"), turnAt(store, estimate), estimate).map(Math.abs);
    return spread(errors, errors.map(() => true));
  }
  const points = { theta: shape.theta_rad, h: shape.h_m };
  const errors = truthDifference(points, store.get("rig/object"), truthAt(store, estimate), estimate);
  return spread(errors.map(Math.abs), shape.touched);
}

/** An accuracy (m) as [number, unit]: µm below a millimetre, mm above. */
export function small(length) {
  if (!Number.isFinite(length)) return ["–", "µm"];
  return length < 0.9995e-3 ? [(length * 1e6).toFixed(0), "µm"] : [(length * 1e3).toFixed(1), "mm"];
}

/** A fraction in per cent, a dash for none. */
export function percent(share) {
  return Number.isFinite(share) ? `${(share * 100).toFixed(0)}\u00a0%` : "–";
}

/** Whether a plan is running; for old runs without that field by the plan's segment. */
export function planRunning(store) {
  const { state, running } = store.get("palm/state");
  return state === "tracking" && (running ?? store.get("palm/motion").segment >= 0);
}

/** The current activity: {words, reason, kind}; `kind` is good, wait, warn or bad. `settling`: convergence of the accuracy. */
export function activity(store, settling) {
  const status = store.get("palm/state");
  const motion = store.get("palm/motion");
  switch (status.state) {
    case "idle":
      return { words: "Waiting for the rig", reason: faultTexts(status).join("; ") || status.cause, kind: "wait" };
    case "ready":
      return { words: "Disarmed: the arm is not commanded", reason: status.cause && `cause: ${status.cause}`, kind: "wait" };
    case "hold":
      return { words: `Held: ${causeOf(status)}`, reason: advice(status, "start resumes the motion"), kind: "warn" };
    case "fault":
      return { words: `Stopped: ${causeOf(status)}`, reason: advice(status, "reset when the cause is removed"), kind: "bad" };
    case "tracking":
      return planRunning(store) ? moving(status, motion) : resting(status, motion, store, settling);
    default:
      return { words: "Nothing is known yet", reason: "", kind: "wait" };
  }
}

function moving(status, { plan, segment, progress }) {
  if (!status.exploring) {
    const done = progress > 0 ? `, ${percent(progress)}` : "";
    return { words: `Running ${plan}${done}`, reason: `segment ${segment + 1}`, kind: "good" };
  }
  return { words: `Exploring for ${status.explored_s.toFixed(0)} s`, reason: status.reason, kind: "good" };
}

function resting({ explored_s: seconds, coverage, coverage_goal: goal, reason, exploring }, { plan }, store, settling) {
  if (!Number.isFinite(seconds) || exploring) {
    return { words: "Armed, no plan is running", reason: plan && `start runs ${plan}`, kind: "wait" };
  }
  const took = `${percent(coverage)} in ${seconds.toFixed(0)} s`;
  if (!(coverage >= goal)) return { words: `Ended at ${took}`, reason, kind: "warn" };
  const [value, unit] = small(settling.value);
  const reached = `${took}, ±\u00a0${value}\u00a0${unit}`;
  if (!store.get("palm/estimate").valid) return { words: `Explored ${took}, but the object is lost`, reason, kind: "warn" };
  return settling.steady ? { words: `Done: ${reached}`, reason, kind: "good" }
    : { words: `Refining: ${reached}`, reason: `${reason && `${reason}; `}the estimate still improves while the palms are at rest`, kind: "wait" };
}

/** The cause of the state; for old runs without that field by their faults. */
function causeOf(status) {
  return status.cause || faultTexts(status).join("; ") || "unknown cause";
}

function faultTexts({ texts, faults = [], severities = [] }) {
  return (texts ?? faults).filter((_, i) => severities[i] === "hold" || severities[i] === "stop");
}

function advice({ hints = [], severities = [], since_s: since }, otherwise) {
  const hint = hints.find((_, i) => severities[i] === "hold" || severities[i] === "stop") ?? otherwise;
  return Number.isFinite(since) ? `${since.toFixed(0)} s ago; ${hint}` : hint;
}
