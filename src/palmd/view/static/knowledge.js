// How well the object is known, and what is going on, in words with the reason. Pure.

import { inSpace } from "./surface.js";
import { offTruth, offTruthInSpace, truthAt, turnAt } from "./truth.js";

/** Where the outline's classes of one-sigma end (m); what is beyond the last is hardly known. */
export const CLASSES_M = [10e-6, 30e-6, 100e-6, 300e-6];

/** The class of a one-sigma (m): 0 for the best known, CLASSES_M.length for what is hardly known. */
export function classOf(sd) {
  const found = CLASSES_M.findIndex((end) => sd <= end);
  return found < 0 ? CLASSES_M.length : found;
}

/** Median and largest of `values` where `counted`, NaN for none. */
export function spread(values, counted) {
  const some = values.filter((_, i) => counted[i]).sort((a, b) => a - b);
  return { typical: some.length ? some[some.length >> 1] : NaN, worst: some.at(-1) ?? NaN };
}

/** One-sigma (m) of the outline where it was touched, typical and worst; NaN unless the estimate is valid. */
export function accuracy(store) {
  const shape = store.get("palm/shape");
  if (!store.get("palm/estimate").valid || !shape.h_m) return { typical: NaN, worst: NaN };
  return spread(shape.h_sd_m, shape.touched);
}

/** How far (m) the outline really is from the emulated rig's truth where it was touched; NaN without one. */
export function error(store, now) {
  const [estimate, shape] = [store.get("palm/estimate"), store.get("palm/shape")];
  if (!estimate.valid || !shape.h_m || !store.truthful(now)) return { typical: NaN, worst: NaN };
  if (inSpace(estimate)) {
    const far = offTruthInSpace(shape, store.get("rig/object"), turnAt(store, estimate), estimate).map(Math.abs);
    return spread(far, far.map(() => true));
  }
  const points = { theta: shape.theta_rad, h: shape.h_m };
  const off = offTruth(points, store.get("rig/object"), truthAt(store, estimate), estimate);
  return spread(off.map(Math.abs), shape.touched);
}

/** A length (m) as an accuracy reads: µm below a millimetre, mm above. */
export function small(length) {
  if (!Number.isFinite(length)) return ["–", "µm"];
  return length < 0.9995e-3 ? [(length * 1e6).toFixed(0), "µm"] : [(length * 1e3).toFixed(1), "mm"];
}

/** A share in per cent, a dash for none. */
export function percent(share) {
  return Number.isFinite(share) ? `${(share * 100).toFixed(0)}\u00a0%` : "–";
}

/** Whether a plan is under way; runs that are older than the field that says so have the plan's place. */
export function underWay(store) {
  const { state, running } = store.get("palm/state");
  return state === "tracking" && (running ?? store.get("palm/motion").segment >= 0);
}

/** What is going on and why: {words, reason, kind}; `kind` is good, wait, warn or bad. `settling`: how the accuracy comes to rest. */
export function activity(store, settling) {
  const said = store.get("palm/state");
  const motion = store.get("palm/motion");
  switch (said.state) {
    case "idle":
      return { words: "Waiting for the rig", reason: standing(said).join("; ") || said.cause, kind: "wait" };
    case "ready":
      return { words: "Disarmed: the arm is not commanded", reason: said.cause && `since: ${said.cause}`, kind: "wait" };
    case "hold":
      return { words: `Held: ${why(said)}`, reason: advice(said, "start goes on"), kind: "warn" };
    case "fault":
      return { words: `Stopped: ${why(said)}`, reason: advice(said, "reset when the cause is gone"), kind: "bad" };
    case "tracking":
      return underWay(store) ? moving(said, motion) : standingStill(said, motion, store, settling);
    default:
      return { words: "Nothing is known yet", reason: "", kind: "wait" };
  }
}

function moving(said, { plan, segment, progress }) {
  if (!said.exploring) {
    const far = progress > 0 ? `, ${percent(progress)}` : "";
    return { words: `Running ${plan}${far}`, reason: `segment ${segment + 1}`, kind: "good" };
  }
  return { words: `Exploring for ${said.explored_s.toFixed(0)} s`, reason: said.reason, kind: "good" };
}

function standingStill({ explored_s: seconds, coverage, coverage_goal: goal, reason, exploring }, { plan }, store, settling) {
  if (!Number.isFinite(seconds) || exploring) {
    return { words: "The arm follows, no plan is running", reason: plan && `start runs ${plan}`, kind: "wait" };
  }
  const took = `${percent(coverage)} in ${seconds.toFixed(0)} s`;
  if (!(coverage >= goal)) return { words: `Ended at ${took}`, reason, kind: "warn" };
  const [value, unit] = small(settling.value);
  const reached = `${took}, ±\u00a0${value}\u00a0${unit}`;
  if (!store.get("palm/estimate").valid) return { words: `Explored ${took}, but the object is lost`, reason, kind: "warn" };
  return settling.steady ? { words: `Done: ${reached}`, reason, kind: "good" }
    : { words: `Refining: ${reached}`, reason: `${reason && `${reason}; `}the estimate still improves while the palms stand`, kind: "wait" };
}

/** What has brought the state about; runs that are older than that field have their faults. */
function why(said) {
  return said.cause || standing(said).join("; ") || "nobody has said why";
}

function standing({ texts, faults = [], severities = [] }) {
  return (texts ?? faults).filter((_, i) => severities[i] === "hold" || severities[i] === "stop");
}

function advice({ hints = [], severities = [], since_s: since }, otherwise) {
  const hint = hints.find((_, i) => severities[i] === "hold" || severities[i] === "stop") ?? otherwise;
  return Number.isFinite(since) ? `${since.toFixed(0)} s ago; ${hint}` : hint;
}
