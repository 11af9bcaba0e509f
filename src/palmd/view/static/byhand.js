// What an operator does besides the buttons: explores, begins a new object, jogs while a button is held, loads plans, writes notes.

import { onSecondPress } from "./guard.js";
import { underWay } from "./knowledge.js";
import { Plans } from "./plans.js";
import { palmsOf } from "./quantities.js";
import { element, number, put, set } from "./text.js";

const STEP_DEG = 0.4; // 8 degrees a second, as `palmd jog`
const EVERY_MS = 50; // the daemon brakes when the next step is 200 ms late
const EXPLORE = "explore.yaml";
const EXPLORATION = "{name: explore, segments: [{explore: {coverage: 0.95, time_limit_s: 90}}]}"; // where no plan of that name is
const UNJOGGED = 3; // looks between new angles where nobody jogs: each costs a layout
const UNANSWERED_MOST = 3; // a line that is held up may not move the palms later

export class ByHand {
  #commands;
  #section;
  #pads = document.getElementById("jog");
  #plans;
  #explore = document.getElementById("explore");
  #anew = document.getElementById("new-object");
  #laidOut = ""; // the palms
  #store = null;
  #timer = 0;
  #unanswered = 0;
  #looks = 0;

  constructor(section, commands) {
    [this.#section, this.#commands] = [section, commands];
    this.#plans = new Plans(document.getElementById("plans"), (path) => commands.give("plan", { path }));
    onSecondPress(this.#explore, () => this.#beginExploring());
    onSecondPress(this.#anew, () => commands.give("new_object"));
    document.getElementById("annotate").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#annotate(document.getElementById("note"));
    });
    for (const end of ["blur", "visibilitychange", "pointerup", "pointercancel"]) {
      (end === "visibilitychange" ? document : window).addEventListener(end, () => this.#letGo());
    }
  }

  /** Lays out what `store` knows of the rig, and enables what applies. */
  offer(store, stale) {
    const info = store.get("palm/info");
    const motion = store.get("palm/motion");
    const { state } = store.get("palm/state");
    this.#store = store;
    put(this.#section, "hidden", !this.#commands.operator);
    this.#layOut(info);
    // only two palms are jogged, and they are the system that has no name
    for (const part of [document.getElementById("jog-line"), this.#pads]) put(part, "hidden", Boolean(info.system));
    const moving = underWay(store);
    const jogs = this.#commands.applies("jog", state, stale) && !moving;
    for (const button of this.#pads.querySelectorAll("button")) put(button, "disabled", !jogs);
    if (!jogs) this.#letGo();
    set("jog-says", jogs ? "" : moving ? "hold the plan first" : "arm first");
    const loads = !moving && this.#commands.applies("plan", state, stale);
    this.#plans.offer(store, loads);
    put(this.#explore, "disabled", !loads);
    put(this.#anew, "disabled", Boolean(info.system) || !this.#commands.applies("new_object", state, stale));
    put(document.getElementById("send-note"), "disabled", !this.#commands.applies("note", state, stale));
    if (!jogs && this.#looks++ % UNJOGGED) return;
    for (const { joint } of palmsOf(info)) set(`jog-${joint}`, number((motion[`${joint}_rad`] * 180) / Math.PI, 1, "°"));
  }

  /** Arms if need be, loads the exploration and starts it, each once the one before is done. */
  #beginExploring() {
    const { plans = [] } = this.#store.get("palm/info");
    const plan = plans.includes(EXPLORE) ? { path: EXPLORE } : { path: EXPLORE, text: EXPLORATION };
    const armed = this.#store.get("palm/state").state !== "ready";
    const steps = [...(armed ? [] : [["arm", {}]]), ["plan", plan], ["start", {}]];
    const next = (error) => {
      if (error) this.#commands.tell(error, true);
      else if (steps.length) this.#commands.give(...steps.shift(), next);
      else this.#commands.tell("explore: done");
    };
    next(null);
  }

  #annotate(note) {
    if (!note.value.trim()) return;
    this.#commands.give("note", { text: note.value.trim() });
    note.value = "";
  }

  #layOut(info) {
    const palms = palmsOf(info);
    const laidOut = JSON.stringify(palms.map(({ joint }) => joint));
    if (laidOut === this.#laidOut) return;
    this.#laidOut = laidOut;
    this.#pads.replaceChildren(...palms.flatMap(({ number: palm, joint }) => [
      element("span", "jogged", `palm ${palm}`),
      this.#handle(joint, -1, `Turn palm ${palm} back while held`, "−"),
      Object.assign(element("output", "number", "–"), { id: `jog-${joint}` }),
      this.#handle(joint, 1, `Turn palm ${palm} on while held`, "+"),
    ]));
  }

  /** A button that turns a joint for as long as it is held down, by pointer, space or enter. */
  #handle(joint, way, label, text) {
    const button = Object.assign(element("button", "handle", text), { type: "button", disabled: true });
    button.setAttribute("aria-label", label);
    const hold = () => this.#hold({ [`${joint}_deg`]: way * STEP_DEG });
    button.addEventListener("pointerdown", ({ button: which, pointerId }) => {
      if (which !== 0) return;
      if (button.hasPointerCapture(pointerId)) button.releasePointerCapture(pointerId); // a finger that slips off lets go
      hold();
    });
    button.addEventListener("keydown", (event) => {
      if (event.key !== " " && event.key !== "Enter") return;
      event.preventDefault();
      if (!event.repeat) hold();
    });
    for (const end of ["keyup", "blur", "pointerleave"]) button.addEventListener(end, () => this.#letGo());
    button.addEventListener("contextmenu", (event) => event.preventDefault()); // a long touch is no menu
    return button;
  }

  #hold(args) {
    this.#letGo();
    const step = () => {
      if (this.#unanswered >= UNANSWERED_MOST) return;
      this.#unanswered += 1;
      const sent = this.#commands.give("jog", args, (error) => {
        this.#unanswered -= 1;
        if (error) this.#refused(error);
      });
      if (!sent) {
        this.#unanswered -= 1;
        this.#letGo();
      }
    };
    this.#timer = setInterval(step, EVERY_MS);
    step();
  }

  #refused(error) {
    this.#letGo();
    document.getElementById("answer").classList.add("bad");
    set("answer", error);
  }

  #letGo() {
    clearInterval(this.#timer);
  }
}
