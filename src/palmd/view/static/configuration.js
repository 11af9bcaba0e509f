// The daemon's configuration file, with the findings of `palmd check`.

import { element, set } from "./text.js";

const CHECKING_MS = 30000;

export class Configuration {
  #library;

  /** `library` as of `Runs`. */
  constructor(library) {
    this.#library = library;
    document.getElementById("check-again").addEventListener("click", () => this.show());
  }

  /** Reads and checks the file again. */
  show() {
    set("config-status", "checking…");
    this.#library("configuration", {}, (error, result) => {
      if (error) {
        set("config-status", error);
        return;
      }
      const { path, text, findings } = result;
      set("config-status", findings.length ? `${path}: ${findings.length} findings of palmd check` : `${path}: no findings of palmd check`);
      const list = document.getElementById("findings");
      list.replaceChildren(...findings.map(({ file, line, column, text: what }) =>
        element("li", "fault", `${line === null ? file : `${file}:${line}:${column}`}: ${what}`)));
      const marked = new Set(findings.filter(({ file }) => file === path).map(({ line }) => line));
      document.getElementById("config-text").replaceChildren(...text.replace(/\n$/, "").split("\n").map((content, i) =>
        element("li", marked.has(i + 1) ? "marked" : "", content)));
    }, CHECKING_MS);
  }
}
