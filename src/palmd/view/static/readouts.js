// State, faults, ages and punctuality in words and numbers. The page's text is only touched where it changes.

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
  const list = document.getElementById("faults");
  const told = JSON.stringify([faults, severities]);
  if (list.dataset.told === told) return;
  list.dataset.told = told;
  list.replaceChildren(...faults.map((code, i) => {
    const row = element("li", "fault", "");
    row.dataset.severity = severities[i];
    row.append(element("span", "severity", severities[i]), element("strong", "", code), element("span", "hint", hints[i]));
    return row;
  }));
  document.getElementById("no-faults").hidden = faults.length > 0;
  set("grave", faults.filter((_, i) => GRAVE.has(severities[i])).join(", "));
}

function showNumbers(store, now, fps) {
  const topics = ["estimate", "contact", "motion", "loop"];
  const [estimate, contact, motion, loop] = topics.map((name) => store.get(`palm/${name}`));
  const age = now - store.palmAt;
  set("age-data", number(age, 0, "ms"));
  for (const pad of [1, 2]) {
    const touch = contact[`touch${pad}`] === undefined ? "" : contact[`touch${pad}`] ? "touched" : "untouched";
    set(`age-pad${pad}`, `${number(contact[`age${pad}_ms`], 0, "ms")} ${touch}`);
  }
  set("age-arm", `${number(contact.arm_age_ms, 0, "ms")}${motion.arm_state ? ` state ${motion.arm_state}` : ""}`);
  set("lateness", ["p50", "p99", "max"].map((part) => number(loop[`lateness_${part}_ms`], 2)).join(" / ") + " ms");
  set("work", ["p50", "p99", "max"].map((part) => number(loop[`work_${part}_ms`], 2)).join(" / ") + " ms");
  set("ticks", loop.ticks === undefined ? "–" : `${loop.ticks}, ${loop.overruns} skipped`);
  set("process", loop.rss_mb === undefined ? "–" : `${number(loop.rss_mb, 0, "MB")}, ${loop.backend} models`);
  set("mass", pair(estimate, "mass_kg", 1e3, 1, "g"));
  set("mu", pair(estimate, "mu", 1, 3, ""));
  set("psi", pair(estimate, "psi_rad", 180 / Math.PI, 1, "°"));
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
  const mm = (value) => (value * 1e3).toFixed(1);
  return `Palms at ${degrees(estimate.phi1_rad)} and ${degrees(estimate.phi2_rad)} degrees, object of about `
    + `${mm((estimate.r1_m + estimate.r2_m) / 2)} millimetres radius, touched over ${share(estimate.touched)} `
    + `of its outline, contact forces ${number(estimate.f1_n, 2)} and ${number(estimate.f2_n, 2)} newtons.`;
}

function degrees(angle) {
  return (angle * 180 / Math.PI).toFixed(0);
}

function pair(fields, name, scale, digits, unit) {
  if (!fields.valid || !Number.isFinite(fields[name])) return "–";
  const sd = fields.sd?.[name];
  return number(fields[name] * scale, digits) + (Number.isFinite(sd) ? ` ± ${number(sd * scale, digits)}` : "")
    + (unit && ` ${unit}`);
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
