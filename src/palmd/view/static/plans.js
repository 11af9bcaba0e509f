// The plans of the rig: which one is loaded or running, and a button to load each.

import { planRunning } from "./knowledge.js";
import { element, put } from "./text.js";

const named = (file) => file.replace(/\.ya?ml$/, "");

export class Plans {
  #list;
  #load;
  #laidOut = "";

  /** `load(file)` is called to load a plan. */
  constructor(list, load) {
    [this.#list, this.#load] = [list, load];
  }

  /** Shows the plans of `palm/info` and marks that of `palm/motion`; `applies`: whether plans can be loaded. */
  offer(store, applies) {
    const { plans = [] } = store.get("palm/info");
    const { plan } = store.get("palm/motion");
    this.#layOut(plans);
    for (const row of this.#list.children) {
      const current = named(row.dataset.file) === plan;
      const words = !current ? "" : planRunning(store) ? "running" : "loaded";
      const [, state, button] = row.children;
      put(state, "textContent", words);
      put(row.dataset, "current", words);
      put(button, "disabled", !applies);
    }
  }

  #layOut(plans) {
    const laidOut = JSON.stringify(plans);
    if (laidOut === this.#laidOut) return;
    this.#laidOut = laidOut;
    this.#list.replaceChildren(...plans.map((file) => {
      const row = element("li", "plan");
      row.dataset.file = file;
      const button = Object.assign(element("button", "small", "Load"), { type: "button", disabled: true });
      button.setAttribute("aria-label", `Load ${file}`);
      button.addEventListener("click", () => this.#load(file));
      row.append(element("span", "file", file), element("span", "running"), button);
      return row;
    }));
  }
}
