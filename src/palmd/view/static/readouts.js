// State, faults, data ages and timing as texts and numbers.

import { chords } from "./geometry.js";
import { planRunning } from "./knowledge.js";
import { AGES, ESTIMATE, palmsOf, shown, shownOfPalm, SHOWS, NUMBERS, hasAny } from "./quantities.js";
import { inSpace } from "./surface.js";
import { SYSTEMS } from "./systems.js";
import { showNotices } from "./notices.js";
import { element, number, put, row, set } from "./text.js";

const STATES = {
  idle: "waiting for the rig",
  ready: "the arm is not commanded",
  tracking: "the arm follows set-points",
  hold: "motion held",
  fault: "stopped by a fault",
};

const TIMES = { lateness: "lateness of a tick", work: "work per tick" };
const PARTS = ["p50", "p99", "max"];

/** Shows the contents of `store` at `now` (ms); `fps`: pictures drawn in the last second. */
export function showReadouts(store, now, fps) {
  showState(store);
  showNotices(store.get("palm/state"), store.get("palm/rig"));
  showObject(store, now);
  showHealth(store, now, fps);
}

/** Creates the rows of the tables. */
export function layOut() {
  document.getElementById("numbers").append(...NUMBERS.map(({ name, title }) => {
    const { symbol, meaning, unit } = ESTIMATE[name];
    const line = row(title, { id: `value-${name}` }, { id: `sd-${name}` }, { text: unit, words: true }, { id: `error-${name}` });
    line.firstChild.append(" ", Object.assign(element("span", "symbol", symbol), { title: meaning }));
    return line;
  }));
  document.getElementById("ages").append(row("palmd", { id: "age-data" }, { id: "status-data", text: "", words: true }),
    ...AGES.map(({ name, title }) => row(title, { id: `age-${name}` }, { id: `status-${name}`, text: "", words: true })));
  document.getElementById("times").append(...Object.entries(TIMES).map(([what, title]) =>
    row(title, ...PARTS.map((part) => ({ id: `${what}-${part}` })))));
}

function showState(store) {
  const { state } = store.get("palm/state");
  const estimate = store.get("palm/estimate");
  set("state", state ?? "unknown");
  put(document.getElementById("state").dataset, "state", state ?? "unknown");
  set("state-means", STATES[state] ?? "");
  const object = store.get("palm/object");
  const recognised = object.best ? `: ${object.best}, ${number(Math.max(...object.probability) * 100, 0, "%")}` : "";
  set("object", estimate.object === undefined ? "" : `object ${estimate.object}${recognised}`);
  const { object: classified, text: shapeClass } = store.get("view/shape_class");
  set("looks-like", shapeClass && estimate.valid && classified === estimate.object ? `looks like: ${shapeClass}` : "");
  set("straight", estimate.valid ? straight(store.get("palm/shape")) : "");
  set("validity", !("valid" in estimate) ? "" : estimate.valid ? "estimate valid" : "estimate not valid");
  put(document.getElementById("validity").dataset, "valid", String(Boolean(estimate.valid)));
}

/** The lengths of the straight parts of the hull, which is what palms touch. */
function straight({ theta_rad: theta, h_m: h, touched }) {
  const found = theta && h ? chords(theta, h, touched) : [];
  const lengths = found.map(([a, b]) => number(Math.hypot(b[0] - a[0], b[1] - a[1]) * 1e3, 1));
  return lengths.length ? `straight over ${lengths.join(", ")} mm: flat side or bridged dent` : "";
}

function showObject(store, now) {
  const estimate = store.get("palm/estimate");
  const truthful = store.truthful(now);
  for (const { name, compared } of NUMBERS) {
    const { factor, digits, truth } = ESTIMATE[name];
    const value = estimate.valid ? estimate[name] : NaN;
    put(document.getElementById(`value-${name}`).parentElement, "hidden", !hasAny([name], estimate));
    set(`value-${name}`, number(value * factor, digits));
    set(`sd-${name}`, number(Number.isFinite(value) ? estimate.sd?.[name] * factor : NaN, digits));
    set(`error-${name}`, truthful && compared ? number((value - store.get(truth)[name]) * factor, digits) : "–");
  }
  const motion = store.get("palm/motion");
  const running = planRunning(store) && motion.segment >= 0;
  set("shows", SHOWS[store.get("palm/info").system ?? ""] ?? "");
  set("plan", motion.plan ? `${motion.plan}${running ? `, segment ${motion.segment + 1}` : ", not running"}` : "none");
  put(document.getElementById("progress"), "value", running ? motion.progress : 0);
}

function showHealth(store, now, fps) {
  const [contact, motion, loop] = ["contact", "motion", "loop"].map((name) => store.get(`palm/${name}`));
  set("age-data", number(now - store.palmAt, 0));
  for (const { name, palm } of AGES) {
    const { factor, digits } = shown("palm/contact", name);
    put(document.getElementById(`age-${name}`).parentElement, "hidden", !hasAny([name], contact));
    set(`age-${name}`, number(contact[name] * factor, digits));
    const touch = contact[`touch${palm}`];
    set(`status-${name}`, palm ? touch === undefined ? "" : touch ? "touched" : "untouched"
      : motion.arm_state ? `state ${motion.arm_state}` : "");
  }
  for (const what of Object.keys(TIMES)) {
    for (const part of PARTS) {
      const { factor, digits } = shown("palm/loop", `${what}_${part}_ms`);
      set(`${what}-${part}`, number(loop[`${what}_${part}_ms`] * factor, digits));
    }
  }
  set("ticks", loop.ticks === undefined ? "–" : `${loop.ticks}, ${loop.overruns} skipped`);
  const { factor, digits, unit } = shown("palm/loop", "rss_mb");
  set("process", loop.rss_mb === undefined ? "–" : `${number(loop.rss_mb * factor, digits, unit)}, ${loop.backend} models`);
  set("fps", number(fps, 0, "per s"));
  const { version, observer } = store.get("palm/info");
  set("version", version ? `palmd ${version}, ${observer} observer` : "");
}

/** A summary of the picture for screen readers. */
export function describe(store) {
  const estimate = store.get("palm/estimate");
  if (!estimate.valid) return "Palms and object; the estimate is not valid.";
  const format = (name) => {
    const { factor, digits, unit } = shownOfPalm(name);
    return number(estimate[name] * factor, digits, unit);
  };
  const own = SYSTEMS.find(({ isOwn }) => isOwn(estimate));
  if (own) return own.describe(store, format);
  const [distance, shape] = inSpace(estimate) ? ["h", "surface"] : ["r", "outline"];
  const palms = palmsOf(store.get("palm/info")).map(({ number: palm, joint }) => `Palm ${palm} at ${format(`${joint}_rad`)}, `
    + `${format(`${distance}${palm}_m`)} from the centre of mass, pressed with ${format(`f${palm}_n`)}.`);
  return `${palms.join(" ")} Touched over ${number(estimate.touched * 100, 0, "%")} of the ${shape}.`;
}
