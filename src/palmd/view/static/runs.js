// The recorded runs: list, search, report, download, delete.

import { onSecondPress } from "./guard.js";
import { element, number, row, set } from "./text.js";

const REPORT_MS = 180000;

/** The searchable text of a run. Pure. */
export function words(run) {
  return [run.run, run.started, run.object, ...run.plans, ...run.faults, ...run.notes, run.problem].join(" ").toLowerCase();
}

export class Runs {
  #library;
  #key = "";
  #runs = [];
  #body = document.getElementById("run-rows");
  #search = document.getElementById("run-search");

  /** `library(command, args, onAnswer)` sends a request to the server; `onAnswer(error, result)`. */
  constructor(library) {
    this.#library = library;
    this.#search.addEventListener("input", () => this.#show());
    document.getElementById("runs-again").addEventListener("click", () => this.list());
  }

  /** Reads the list again; the server's first message has the key for downloads. */
  list(hello = { library: this.#key }) {
    this.#key = hello?.library ?? "";
    set("runs-status", "reading the runs…");
    this.#library("runs", {}, (error, result) => {
      set("runs-status", error ?? `${result.runs.length} in ${result.folder}`);
      this.#runs = error ? [] : result.runs;
      this.#show();
    });
  }

  #show() {
    const wanted = this.#search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const found = this.#runs.filter((run) => wanted.every((word) => words(run).includes(word)));
    this.#body.replaceChildren(...found.map((run) => this.#row(run)));
    set("runs-found", wanted.length ? `${found.length} found` : "");
  }

  #row(run) {
    const name = run.run.replace(/\.mcap$/, "");
    const troubles = [...(run.lost ? [`lost ${run.lost}×`] : []), ...run.faults, ...run.notes.map((note) => `“${note}”`), run.problem].filter(Boolean);
    const cells = [
      [number(run.seconds, 0, "s"), "number"], [run.plans.join(", "), ""], [number(run.touched * 100, 0, "%"), "number"],
      [number(run.sd_m * 1e6, 0, "µm"), "number"], [number(run.size_bytes / 1e6, 1, "MB"), "number"], [troubles.join(", "), "troubles"],
    ];
    const line = row(name);
    line.append(...cells.map(([text, kind]) => element("td", kind, text)), this.#actions(run, name));
    return line;
  }

  #actions(run, name) {
    const cell = element("td", "actions");
    const report = Object.assign(element("button", "small", "Report"), { type: "button" });
    report.setAttribute("aria-label", `Report of ${name}`);
    report.addEventListener("click", () => this.#report(run, report));
    const download = Object.assign(element("a", "small button", "Download"), { href: `files/${this.#key}/${run.run}`, download: run.run });
    download.setAttribute("aria-label", `Download ${name}`);
    const remove = Object.assign(element("button", "small", "Delete"), { type: "button" });
    remove.setAttribute("aria-label", `Delete ${name}`);
    onSecondPress(remove, () => this.#library("delete", { run: run.run }, (error) => {
      set("runs-status", error ?? `${name} is deleted`);
      if (error) return;
      this.#runs = this.#runs.filter((each) => each !== run);
      this.#show();
    }));
    cell.append(report, download, remove);
    return cell;
  }

  /** Makes the report, which takes some seconds, and opens it in a new window. */
  #report(run, button) {
    const page = open("", "_blank");
    if (page) page.document.title = "palmd: making the report…";
    button.disabled = true;
    set("runs-status", `making the report of ${run.run}…`);
    this.#library("report", { run: run.run }, (error, result) => {
      button.disabled = false;
      set("runs-status", error ?? `report of ${run.run}: opened`);
      if (error) page?.close();
      else if (page) page.location = `${location.origin}/files/${this.#key}/${result.file}`;
      else set("runs-status", "the browser blocked the window: allow pop-ups for this page");
    }, REPORT_MS);
  }
}
