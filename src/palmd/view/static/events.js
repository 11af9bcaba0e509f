// The daemon's log: its entries, and the latest of them beside the picture, with their age.

import { fillText, showInSlots } from "./slots.js";
import { element, put } from "./text.js";

const SHOWN = 6;

const HEADS = { // prefix of an entry's text by kind; default: the kind
  state: () => "",
  fault: ({ name }) => `${name}: `,
  command: ({ name, who }) => `${name}, by ${who}: `,
};

/** The entries of `palm/log`, the oldest first: [{number, t, kind, name, severity, who, text}]. Pure. */
export function entriesOf({ number = [], t_s: t = [], kind = [], name = [], severity = [], who = [], text = [] }) {
  return t.map((at, i) => ({
    number: number[i], t: at, kind: kind[i], name: name[i], severity: severity[i] ?? "", who: who[i], text: text[i],
  }));
}

/** An entry's text with its prefix. Pure. */
export function headed(entry) {
  return (HEADS[entry.kind]?.(entry) ?? `${entry.kind}: `) + entry.text;
}

/** The last entries of `palm/log` as rows {ago, severity, text}, the newest first; `t` (s) is now by the daemon's clock. Pure. */
export function lately(log, t) {
  return entriesOf(log).slice(-SHOWN).reverse().map((entry) =>
    ({ ago: `${Math.max(t - entry.t, 0).toFixed(0)} s ago`, severity: entry.severity, text: headed(entry) }));
}

/** Shows them in `section`. */
export function showEvents(section, log, t) {
  showInSlots(section.querySelector("ol"), lately(log, t), make, (row, { ago, severity, text }) => {
    put(row.dataset, "severity", severity);
    const [when, what] = row.children;
    put(when, "textContent", ago);
    fillText(what, text);
  });
}

function make() {
  const row = element("li", "event");
  row.append(element("span", "ago"), element("span", "what"));
  return row;
}
