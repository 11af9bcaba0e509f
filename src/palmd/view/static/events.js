// What has happened lately, by the daemon's log: the newest first, each with how long ago it was and why.

import { element } from "./text.js";

const SHOWN = 12;

const HEADS = { // what stands before the words of an entry; else its kind does
  state: () => "",
  fault: ({ name }) => `${name}: `,
  command: ({ name, who }) => `${name}, by ${who}: `,
};

/** The last entries of `palm/log` as rows {ago, severity, text}, the newest first; `t` (s) is now by the daemon's clock. Pure. */
export function lately({ t_s: times = [], kind = [], name = [], severity = [], who = [], text = [] }, t) {
  return times.map((at, i) => {
    const head = HEADS[kind[i]]?.({ name: name[i], who: who[i] }) ?? `${kind[i]}: `;
    return { ago: `${Math.max(t - at, 0).toFixed(0)} s ago`, severity: severity[i] ?? "", text: head + text[i] };
  }).slice(-SHOWN).reverse();
}

/** Shows them in `section`, which is hidden while there are none. */
export function showEvents(section, log, t) {
  const rows = lately(log, t);
  section.hidden = rows.length === 0;
  const list = section.querySelector("ol");
  const told = JSON.stringify(rows);
  if (list.dataset.told === told) return;
  list.dataset.told = told;
  list.replaceChildren(...rows.map(({ ago, severity, text }) => {
    const row = element("li", "");
    row.dataset.severity = severity;
    row.append(element("span", "ago", ago), element("span", "", text));
    return row;
  }));
}
