// The figures that matter, large: how much of the outline is known, how well, the mass, and what is going on.

import { accuracy, activity, error, percent, small, underWay } from "./knowledge.js";
import { ESTIMATE } from "./quantities.js";
import { Settling } from "./settling.js";
import { number, put, set } from "./text.js";

const settling = new Settling();
const STARVED_MS = 10000; // for so long it is told

/** Shows what `store` knows at `now` (ms). */
export function showHero(store, now) {
  const estimate = store.get("palm/estimate");
  const { coverage, reachable } = store.get("palm/state");
  if (underWay(store)) settling.reset();
  settling.take(accuracy(store).typical, now / 1000);
  const { words, reason, kind } = activity(store, settling);
  set("words", words);
  set("reason", [starved(store, now), [reason, doubt(estimate)].filter(Boolean).join("; ")].filter(Boolean).join(" "));
  for (const place of [document.getElementById("words"), document.getElementById("reason")]) {
    put(place, "title", place.textContent); // what may be cut off can be read as a title
  }
  put(document.getElementById("going-on").dataset, "kind", kind);
  set("known", Number.isFinite(estimate.touched) ? number(estimate.touched * 100, 0) : "–");
  put(document.getElementById("known-bar"), "value", estimate.touched || 0);
  set("known-of", estimate.valid && Number.isFinite(coverage) ? `${percent(coverage)} of what can be reached`
    + (reachable < 0.995 ? `, which is ${percent(reachable)}` : "") : "");
  showAccuracy(accuracy(store), error(store, now));
  showMass(estimate, store.truthful(now) ? store.get("rig/object").mass_kg : NaN);
}

/** What speaks against the estimate, by the daemon's words or codes; empty for a valid one. */
function doubt({ valid, reason, invalid_reasons: codes = [] }) {
  return valid === false ? `no valid estimate: ${reason || codes.join(", ") || "no reason is published"}` : "";
}

/** What an emulated rig has lately said of itself: it stood still, which no pad and no arm is to blame for. */
function starved(store, now) {
  if (store.age("rig/stall", now) > STARVED_MS) return "";
  const { lasted_s: seconds, count } = store.get("rig/stall");
  return `The emulated rig itself got no processor for ${(seconds * 1e3).toFixed(0)}\u00a0ms`
    + `${count > 1 ? ` (${count} times so far)` : ""}: nothing came from pads and arm.`;
}

function showAccuracy({ typical, worst }, off) {
  const [value, unit] = small(typical);
  set("typical", Number.isFinite(typical) ? `± ${value}` : value);
  set("typical-unit", unit);
  const [most, its] = small(worst);
  set("worst", Number.isFinite(worst) ? `worst ±\u00a0${most}\u00a0${its}` : "");
  set("off-truth", Number.isFinite(off.typical) ? `truth: ${small(off.typical).join("\u00a0")} off, worst ${small(off.worst).join("\u00a0")}` : "");
}

function showMass({ valid, mass_kg: mass, sd }, truth) {
  const { factor, digits, unit } = ESTIMATE.mass_kg;
  const known = valid && Number.isFinite(mass);
  set("mass", known ? number(mass * factor, digits) : "–");
  set("mass-unit", unit);
  set("mass-sd", known && Number.isFinite(sd?.mass_kg) ? `± ${number(sd.mass_kg * factor, digits, unit)}` : "");
  set("mass-truth", known && Number.isFinite(truth) ? `truth: ${number((mass - truth) * factor, digits, unit)} off` : "");
}

/** What has come of it, once nothing more will: [[what, how much]]. */
export function summary(store, now) {
  const estimate = store.get("palm/estimate");
  const { words } = activity(store, settling);
  const well = accuracy(store);
  const off = error(store, now);
  const { factor, digits, unit } = ESTIMATE.mass_kg;
  return [
    ["at last", words],
    ["outline known", percent(estimate.touched)],
    ["accuracy", `± ${small(well.typical).join(" ")}, worst ± ${small(well.worst).join(" ")}`],
    ["off the rig’s truth", Number.isFinite(off.typical) ? `${small(off.typical).join("\u00a0")}, worst ${small(off.worst).join("\u00a0")}` : "–"],
    ["mass", estimate.valid ? number(estimate.mass_kg * factor, digits, unit) : "–"],
  ];
}
