// Faults, and deviations of the rig from its description: counted, in a list whose size never moves other elements.

import { fillText, showInSlots } from "./slots.js";
import { element, put, set } from "./text.js";

const ORDER = ["stop", "hold", "degrade", "note", "rig"];
const SEVERE = new Set(["stop", "hold"]);

/** Rows {kind, code, text}, the most severe first. Pure. */
export function notices({ faults = [], severities = [], hints = [] }, { contradictions = [] }) {
  const rows = faults.map((code, i) => ({ kind: severities[i], code, text: hints[i] ?? "" }));
  rows.push(...contradictions.map((text) => ({ kind: "rig", code: "", text })));
  return rows.sort((a, b) => ORDER.indexOf(a.kind) - ORDER.indexOf(b.kind));
}

/** The number of rows of each kind as text. Pure. */
export function counted(rows) {
  const counts = ORDER.map((kind) => [kind, rows.filter((row) => row.kind === kind).length]).filter(([, count]) => count);
  return rows.length ? `${rows.length}: ${counts.map(([kind, count]) => `${count} ${kind}`).join(", ")}` : "none";
}

/** Shows the notices of `palm/state` and `palm/rig`. */
export function showNotices(state, rig) {
  const rows = notices(state, rig);
  set("notice-count", counted(rows));
  set("grave", rows.filter(({ kind }) => SEVERE.has(kind)).map(({ code }) => code).join(", "));
  showInSlots(document.getElementById("faults"), rows, make, (row, { kind, code, text }) => {
    put(row.dataset, "severity", kind);
    const [severity, hint] = row.children;
    fillText(severity, kind);
    fillText(hint, [code, text].filter(Boolean).join(": "));
  });
}

function make() {
  const row = element("li", "fault");
  row.append(element("span", "severity"), element("span", "hint"));
  return row;
}
