// State, faults, ages and punctuality in words and numbers. The page's text is only touched where it changes.

import { ESTIMATE, shown, TOLD } from "./quantities.js";

const STATES = {
  idle: "waiting for the rig",
  ready: "the arm stands, uncommanded",
  tracking: "the arm follows",
  hold: "motion held",
  fault: "stopped by a fault",
};

const GRAVE = new Set(["hold", "stop"]);

/** Shows what `store` knows at `now` (ms); `fps` is how often the scene was drawn in the last second. */
export function showReadouts(store, now, fps) {
  showState(store);
  showFaults(store.get("palm/state"));
  showRig(store.get("palm/rig"));
  showNumbers(store, now, fps);
}

function showState(store) {
  const { state } = store.get("palm/state");
  const estimate = store.get("palm/estimate");
  set("state", state ?? "unknown");
  document.getElementById("state").dataset.state = state ?? "unknown";
  set("state-means", STATES[state] ?? "");
  const object = store.get("palm/object");
  const recognised = object.best ? `: ${object.best}, ${share(Math.max(...object.probability))}` : "";
  set("object", estimate.object === undefined ? "" : `object ${estimate.object}${recognised}`);
  set("validity", !("valid" in estimate) ? "" : estimate.valid ? "estimate valid" : "not settled yet");
  document.getElementById("validity").dataset.valid = String(Boolean(estimate.valid));
}

function showFaults({ faults = [], severities = [], hints = [] }) {
  showRows("faults", faults.map((code, i) => [severities[i], element("strong", "", code), element("span", "hint", hints[i])]));
  document.getElementById("no-faults").hidden = faults.length > 0;
  set("grave", faults.filter((_, i) => GRAVE.has(severities[i])).join(", "));
}

/** What readings have told of the rig to be off. */
function showRig({ off = [] }) {
  showRows("rig-off", off.map((said) => ["rig", element("span", "", said)]));
}

/** Rows of a kind and what stands behind it; the list is only touched where it changes. */
function showRows(id, rows) {
  const list = document.getElementById(id);
  const told = JSON.stringify(rows.map(([kind, ...parts]) => [kind, ...parts.map((part) => part.textContent)]));
  if (list.dataset.told === told) return;
  list.dataset.told = told;
  list.replaceChildren(...rows.map(([kind, ...parts]) => {
    const row = element("li", "fault", "");
    row.dataset.severity = kind;
    row.append(element("span", "severity", kind), ...parts);
    return row;
  }));
}

function showNumbers(store, now, fps) {
  const topics = ["estimate", "contact", "motion", "loop"];
  const [estimate, contact, motion, loop] = topics.map((name) => store.get(`palm/${name}`));
  const age = now - store.palmAt;
  set("age-data", number(age, 0, "ms"));
  for (const pad of [1, 2]) {
    const touch = contact[`touch${pad}`] === undefined ? "" : contact[`touch${pad}`] ? "touched" : "untouched";
    set(`age-pad${pad}`, `${told("palm/contact", contact, `age${pad}_ms`)} ${touch}`);
  }
  set("age-arm", `${told("palm/contact", contact, "arm_age_ms")}${motion.arm_state ? ` state ${motion.arm_state}` : ""}`);
  for (const what of ["lateness", "work"]) {
    set(what, ["p50", "p99", "max"].map((part) => told("palm/loop", loop, `${what}_${part}_ms`)).join(" / "));
  }
  set("ticks", loop.ticks === undefined ? "–" : `${loop.ticks}, ${loop.overruns} skipped`);
  set("process", loop.rss_mb === undefined ? "–" : `${told("palm/loop", loop, "rss_mb")}, ${loop.backend} models`);
  for (const { name } of TOLD) set(name, pair(estimate, name));
  set("touched", share(estimate.touched));
  const running = motion.segment >= 0;
  set("plan", motion.plan ? `${motion.plan}${running ? `, segment ${motion.segment + 1}` : ", not running"}` : "none");
  document.getElementById("progress").value = running ? motion.progress : 0;
  set("fps", number(fps, 0, "per s"));
  const version = store.get("palm/info").version;
  set("version", version ? `palmd ${version}, ${store.get("palm/info").observer} observer` : "");
}

/** A summary of the picture for those who cannot see it. */
export function describe(store) {
  const estimate = store.get("palm/estimate");
  if (!estimate.valid) return "Palms and object; the estimate has not settled.";
  const say = (name) => told("palm/estimate", estimate, name);
  return `Palms at ${say("phi1_rad")} and ${say("phi2_rad")}, centre of mass ${say("r1_m")} and ${say("r2_m")} from `
    + `them, touched over ${share(estimate.touched)} of the outline, contact forces ${say("f1_n")} and ${say("f2_n")}.`;
}

/** Rows for what of the estimate is told as numbers alone, before the first row of `list`. */
export function layOut(list) {
  list.prepend(...TOLD.flatMap(({ name, title }) => {
    const { symbol, meaning } = ESTIMATE[name];
    const term = Object.assign(element("dt", "", `${title} ${symbol}`), { title: meaning });
    return [term, Object.assign(element("dd", "", "–"), { id: name })];
  }));
}

/** A quantity among the fields of its topic, with its unit. */
function told(topic, fields, name) {
  const { factor, digits, unit } = shown(topic, name);
  return number(fields[name] * factor, digits, unit);
}

/** A valid estimate with its sigma. */
function pair(estimate, name) {
  const { factor, digits, unit } = ESTIMATE[name];
  if (!estimate.valid || !Number.isFinite(estimate[name])) return "–";
  const sd = estimate.sd?.[name];
  return number(estimate[name] * factor, digits)
    + (Number.isFinite(sd) ? ` ± ${number(sd * factor, digits)}` : "") + (unit && ` ${unit}`);
}

function share(value) {
  return number(value * 100, 0, "%");
}

/** A number with its unit and a proper minus sign, a dash for none. */
export function number(value, digits, unit = "") {
  if (!Number.isFinite(value)) return "–";
  return value.toFixed(digits).replace(/^-(?=[0.]*$)/, "").replace("-", "−") + (unit && ` ${unit}`);
}

export function set(id, text) {
  const place = document.getElementById(id);
  if (place.textContent !== text) place.textContent = text;
}

function element(name, className, text) {
  return Object.assign(document.createElement(name), { className, textContent: text });
}
