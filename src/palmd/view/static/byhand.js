// Manual control besides the command buttons: explore, new object, jog while a button is held, load plans, write notes.

import { onSecondPress } from "./guard.js";
import { planRunning } from "./knowledge.js";
import { Plans } from "./plans.js";
import { palmsOf } from "./quantities.js";
import { element, number, put, set } from "./text.js";

// 8 degrees per second, as `palmd jog`
const STEP_DEG = 0.4;
// The daemon brakes if the next step is 200 ms late
const EVERY_MS = 50;
const EXPLORE = "explore.yaml";
// Used if there is no plan of that name
const EXPLORATION = "{name: explore, segments: [{explore: {coverage: 0.95, time_limit_s: 90}}]}";
// Without jogging the angles change at every third update, as each change costs a layout
const ANGLE_UPDATES = 3;
// Unanswered jog steps; delayed ones must not move the palms later
const MAX_UNANSWERED = 3;

export class ByHand {
  #commands;
  #section;
  #pads = document.getElementById("jog");
  #plans;
  #explore = document.getElementById("explore");
  #newObject = document.getElementById("new-object");
  // The joints that have buttons
  #laidOut = "";
  #store = null;
  #timer = 0;
  #unanswered = 0;
  #updates = 0;

  constructor(section, commands) {
    [this.#section, this.#commands] = [section, commands];
    this.#plans = new Plans(document.getElementById("plans"), (path) => commands.give("plan", { path }));
    onSecondPress(this.#explore, () => this.#beginExploring());
    onSecondPress(this.#newObject, () => commands.give("new_object"));
    document.getElementById("annotate").addEventListener("submit", (event) => {
      event.preventDefault();
      this.#annotate(document.getElementById("note"));
    });
    for (const end of ["blur", "visibilitychange", "pointerup", "pointercancel"]) {
      (end === "visibilitychange" ? document : window).addEventListener(end, () => this.#letGo());
    }
  }

  /** Creates the buttons for the rig in `store`, and enables those that apply. */
  offer(store, stale) {
    const info = store.get("palm/info");
    const motion = store.get("palm/motion");
    const { state } = store.get("palm/state");
    this.#store = store;
    put(this.#section, "hidden", !this.#commands.operator);
    this.#layOut(info);
    // only two palms can be jogged; they are the system without a name
    for (const part of [document.getElementById("jog-line"), this.#pads]) put(part, "hidden", Boolean(info.system));
    const moving = planRunning(store);
    const jogs = this.#commands.applies("jog", state, stale) && !moving;
    for (const button of this.#pads.querySelectorAll("button")) put(button, "disabled", !jogs);
    if (!jogs) this.#letGo();
    set("jog-hint", jogs ? "" : moving ? "hold the plan first" : "arm first");
    const loads = !moving && this.#commands.applies("plan", state, stale);
    this.#plans.offer(store, loads);
    put(this.#explore, "disabled", !loads);
    put(this.#newObject, "disabled", Boolean(info.system) || !this.#commands.applies("new_object", state, stale));
    put(document.getElementById("send-note"), "disabled", !this.#commands.applies("note", state, stale));
    if (!jogs && this.#updates++ % ANGLE_UPDATES) return;
    for (const { joint } of palmsOf(info)) set(`jog-${joint}`, number((motion[`${joint}_rad`] * 180) / Math.PI, 1, "°"));
  }

  /** Arms if necessary, loads the exploration and starts it, one step after the other. */
  #beginExploring() {
    const { plans = [] } = this.#store.get("palm/info");
    const plan = plans.includes(EXPLORE) ? { path: EXPLORE } : { path: EXPLORE, text: EXPLORATION };
    const armed = this.#store.get("palm/state").state !== "ready";
    const steps = [...(armed ? [] : [["arm", {}]]), ["plan", plan], ["start", {}]];
    const next = (error) => {
      if (error) this.#commands.show(error, true);
      else if (steps.length) this.#commands.give(...steps.shift(), next);
      else this.#commands.show("explore: done");
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
      this.#handle(joint, 1, `Turn palm ${palm} forward while held`, "+"),
    ]));
  }

  /** A button that turns a joint while it is held down by pointer, space or enter. */
  #handle(joint, direction, label, text) {
    const button = Object.assign(element("button", "handle", text), { type: "button", disabled: true });
    button.setAttribute("aria-label", label);
    const hold = () => this.#hold({ [`${joint}_deg`]: direction * STEP_DEG });
    button.addEventListener("pointerdown", ({ button: which, pointerId }) => {
      if (which !== 0) return;
      if (button.hasPointerCapture(pointerId)) button.releasePointerCapture(pointerId); // a finger that leaves the button releases it
      hold();
    });
    button.addEventListener("keydown", (event) => {
      if (event.key !== " " && event.key !== "Enter") return;
      event.preventDefault();
      if (!event.repeat) hold();
    });
    for (const end of ["keyup", "blur", "pointerleave"]) button.addEventListener(end, () => this.#letGo());
    button.addEventListener("contextmenu", (event) => event.preventDefault()); // no menu on a long touch
    return button;
  }

  #hold(args) {
    this.#letGo();
    const step = () => {
      if (this.#unanswered >= MAX_UNANSWERED) return;
      this.#unanswered += 1;
      const sent = this.#commands.give("jog", args, (error) => {
        this.#unanswered -= 1;
        if (error) this.#stopWithError(error);
      });
      if (!sent) {
        this.#unanswered -= 1;
        this.#letGo();
      }
    };
    this.#timer = setInterval(step, EVERY_MS);
    step();
  }

  #stopWithError(error) {
    this.#letGo();
    document.getElementById("answer").classList.add("bad");
    set("answer", error);
  }

  #letGo() {
    clearInterval(this.#timer);
  }
}
