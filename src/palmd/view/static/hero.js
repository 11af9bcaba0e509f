// The main results in large type: coverage, accuracy, mass, and current activity.

import { accuracy, activity, error, percent, small, planRunning } from "./knowledge.js";
import { ESTIMATE } from "./quantities.js";
import { Settling } from "./settling.js";
import { number, put, set } from "./text.js";

const settling = new Settling();
const RIG_STALL_MS = 10000; // how long a stall of the rig is shown

/** Shows what `store` knows at `now` (ms). */
export function showHero(store, now) {
  const estimate = store.get("palm/estimate");
  const { coverage, reachable } = store.get("palm/state");
  if (planRunning(store)) settling.reset();
  settling.take(accuracy(store).typical, now / 1000);
  const { words, reason, kind } = activity(store, settling);
  set("words", words);
  set("reason", [rigStall(store, now), [reason, invalidReason(estimate)].filter(Boolean).join("; ")].filter(Boolean).join(" "));
  for (const place of [document.getElementById("words"), document.getElementById("reason")]) {
    put(place, "title", place.textContent); // shows text that is cut off
  }
  put(document.getElementById("going-on").dataset, "kind", kind);
  set("known", Number.isFinite(estimate.touched) ? number(estimate.touched * 100, 0) : "–");
  put(document.getElementById("known-bar"), "value", estimate.touched || 0);
  set("known-of", estimate.valid && Number.isFinite(coverage) ? `${percent(coverage)} of what can be reached`
    + (reachable < 0.995 ? `, which is ${percent(reachable)}` : "") : "");
  showAccuracy(accuracy(store), error(store, now));
  showMass(estimate, store.truthful(now) ? store.get("rig/object").mass_kg : NaN);
}

/** Why the estimate is invalid, by the daemon's text or codes; empty for a valid one. */
function invalidReason({ valid, reason, invalid_reasons: codes = [] }) {
  return valid === false ? `no valid estimate: ${reason || codes.join(", ") || "no reason is published"}` : "";
}

/** A recent stall of the emulated rig, which is not a fault of pads or arm. */
function rigStall(store, now) {
  if (store.age("rig/stall", now) > RIG_STALL_MS) return "";
  const { lasted_s: seconds, count } = store.get("rig/stall");
  return `The emulated rig itself got no processor time for ${(seconds * 1e3).toFixed(0)}\u00a0ms`
    + `${count > 1 ? ` (${count} times so far)` : ""}: no data from pads and arm.`;
}

function showAccuracy({ typical, worst }, errors) {
  const [value, unit] = small(typical);
  set("typical", Number.isFinite(typical) ? `± ${value}` : value);
  set("typical-unit", unit);
  const [worstValue, worstUnit] = small(worst);
  set("worst", Number.isFinite(worst) ? `worst ±\u00a0${worstValue}\u00a0${worstUnit}` : "");
  set("error-to-truth", Number.isFinite(errors.typical) ? `error to truth: ${small(errors.typical).join("\u00a0")}, worst ${small(errors.worst).join("\u00a0")}` : "");
}

function showMass({ valid, mass_kg: mass, sd }, truth) {
  const { factor, digits, unit } = ESTIMATE.mass_kg;
  const known = valid && Number.isFinite(mass);
  set("mass", known ? number(mass * factor, digits) : "–");
  set("mass-unit", unit);
  set("mass-sd", known && Number.isFinite(sd?.mass_kg) ? `± ${number(sd.mass_kg * factor, digits, unit)}` : "");
  set("mass-truth", known && Number.isFinite(truth) ? `error to truth: ${number((mass - truth) * factor, digits, unit)}` : "");
}

/** The final result as rows [name, value]. */
export function summary(store, now) {
  const estimate = store.get("palm/estimate");
  const { words } = activity(store, settling);
  const sds = accuracy(store);
  const errors = error(store, now);
  const { factor, digits, unit } = ESTIMATE.mass_kg;
  return [
    ["final state", words],
    ["outline known", percent(estimate.touched)],
    ["accuracy", `± ${small(sds.typical).join(" ")}, worst ± ${small(sds.worst).join(" ")}`],
    ["error to the rig’s truth", Number.isFinite(errors.typical) ? `${small(errors.typical).join("\u00a0")}, worst ${small(errors.worst).join("\u00a0")}` : "–"],
    ["mass", estimate.valid ? number(estimate.mass_kg * factor, digits, unit) : "–"],
  ];
}
