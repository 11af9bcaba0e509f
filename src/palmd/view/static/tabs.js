// The page's views, one at a time: a tab list after the ARIA authoring practices.

const STEPS = { ArrowLeft: -1, ArrowRight: 1 };

export class Tabs {
  #tabs;
  #onOpened;

  /** `onOpened(name)` is called when a view is opened; the tabs name their panels by `aria-controls`. */
  constructor(list, onOpened) {
    this.#tabs = [...list.querySelectorAll("[role=tab]")];
    this.#onOpened = onOpened;
    for (const tab of this.#tabs) tab.addEventListener("click", () => this.open(tab.dataset.view));
    list.addEventListener("keydown", (event) => {
      const at = this.#tabs.indexOf(document.activeElement);
      if (!(event.key in STEPS) || at < 0) return;
      event.preventDefault();
      const next = this.#tabs[(at + STEPS[event.key] + this.#tabs.length) % this.#tabs.length];
      next.focus();
      this.open(next.dataset.view);
    });
  }

  /** Opens the view of that name. */
  open(name) {
    for (const tab of this.#tabs) {
      const chosen = tab.dataset.view === name;
      tab.setAttribute("aria-selected", String(chosen));
      tab.tabIndex = chosen ? 0 : -1;
      document.getElementById(tab.getAttribute("aria-controls")).hidden = !chosen;
    }
    this.#onOpened(name);
  }
}
