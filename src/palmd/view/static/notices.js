// Faults and what is off about the rig: counted, in a list of its own that never moves anything else.

import { fillText, showInSlots } from "./slots.js";
import { element, put, set } from "./text.js";

const ORDER = ["stop", "hold", "degrade", "note", "rig"];
const GRAVE = new Set(["stop", "hold"]);

/** Rows {kind, code, text}, the gravest first. Pure. */
export function notices({ faults = [], severities = [], hints = [] }, { off = [] }) {
  const rows = faults.map((code, i) => ({ kind: severities[i], code, text: hints[i] ?? "" }));
  rows.push(...off.map((text) => ({ kind: "rig", code: "", text })));
  return rows.sort((a, b) => ORDER.indexOf(a.kind) - ORDER.indexOf(b.kind));
}

/** How many of each kind, in words. Pure. */
export function counted(rows) {
  const counts = ORDER.map((kind) => [kind, rows.filter((row) => row.kind === kind).length]).filter(([, count]) => count);
  return rows.length ? `${rows.length}: ${counts.map(([kind, count]) => `${count} ${kind}`).join(", ")}` : "none";
}

/** Shows what `palm/state` and `palm/rig` say. */
export function showNotices(state, rig) {
  const rows = notices(state, rig);
  set("notice-count", counted(rows));
  set("grave", rows.filter(({ kind }) => GRAVE.has(kind)).map(({ code }) => code).join(", "));
  showInSlots(document.getElementById("faults"), rows, make, (row, { kind, code, text }) => {
    put(row.dataset, "severity", kind);
    const [severity, said] = row.children;
    fillText(severity, kind);
    fillText(said, [code, text].filter(Boolean).join(": "));
  });
}

function make() {
  const row = element("li", "fault");
  row.append(element("span", "severity"), element("span", "hint"));
  return row;
}
