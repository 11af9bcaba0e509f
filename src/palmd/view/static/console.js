// The event log of the run, oldest first, with filters by kind and words.

import { entriesOf, headed } from "./events.js";
import { element, set } from "./text.js";

const MAX_ENTRIES = 2000;

export class Console {
  #entries = [];
  #last = NaN; // number of the newest entry
  #kind = document.getElementById("log-kind");
  #words = document.getElementById("log-words");
  #list = document.getElementById("log-rows");
  #follow = document.getElementById("log-follow");
  #open = false;

  constructor() {
    for (const filter of [this.#kind, this.#words]) filter.addEventListener("input", () => this.#showAll());
  }

  /** Sets whether the log is visible. */
  setVisible(open) {
    this.#open = open;
    if (open) this.#showAll();
  }

  /** Takes a message of `palm/log`, which repeats the last entries; `offsetS`: wall clock minus the daemon's clock (s). */
  take(log, offsetS) {
    const entries = entriesOf(log);
    if (entries.length && entries.at(-1).number < this.#last) [this.#entries, this.#last] = [[], NaN]; // the daemon was restarted
    const fresh = entries.filter(({ number }) => !(number <= this.#last)).map((entry) => ({ ...entry, at: new Date((entry.t + offsetS) * 1e3) }));
    if (!fresh.length) return;
    this.#last = fresh.at(-1).number;
    this.#entries.push(...fresh);
    this.#entries.splice(0, this.#entries.length - MAX_ENTRIES);
    if (!this.#open) return;
    this.#offerKinds();
    const shown = fresh.filter((entry) => this.#passes(entry));
    this.#list.append(...shown.map(rowOf));
    while (this.#list.children.length > MAX_ENTRIES) this.#list.firstChild.remove();
    this.#updateCount();
  }

  #passes(entry) {
    const kind = this.#kind.value;
    const severe = ["degrade", "hold", "stop"].includes(entry.severity);
    const text = `${entry.kind} ${entry.name} ${headed(entry)}`.toLowerCase();
    return (!kind || kind === entry.kind || (kind === "severe" && severe))
      && this.#words.value.toLowerCase().split(/\s+/).every((word) => text.includes(word));
  }

  #offerKinds() {
    const known = new Set([...this.#kind.options].map(({ value }) => value));
    for (const { kind } of this.#entries) {
      if (known.has(kind)) continue;
      known.add(kind);
      this.#kind.append(new Option(kind, kind));
    }
  }

  #showAll() {
    this.#offerKinds();
    this.#list.replaceChildren(...this.#entries.filter((entry) => this.#passes(entry)).map(rowOf));
    this.#updateCount();
  }

  #updateCount() {
    set("log-count", `${this.#list.children.length} of ${this.#entries.length} entries`);
    if (this.#follow.checked) this.#list.scrollTop = this.#list.scrollHeight;
  }
}

function rowOf(entry) {
  const row = element("li", "");
  row.dataset.severity = entry.severity;
  row.append(element("time", "at", entry.at.toTimeString().slice(0, 8)), element("span", "kind", entry.kind), element("span", "", headed(entry)));
  return row;
}
