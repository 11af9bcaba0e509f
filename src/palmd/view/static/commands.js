// The command buttons: which of them apply, the second press that arm and start need, keys, and the answers.

import { underWay } from "./knowledge.js";
import { put, set } from "./text.js";

const CONFIRM_MS = 3000;
const DOUBLE_CLICK_MS = 350; // two presses within it are one
const ANSWER_MS = 2500; // the server itself gives up after 2 s
const MOVED = ["T", "H", "D"]; // the arm's states in which there is something to stop
const GUARDED = new Set(["arm", "start"]);
const NEEDS_CONTROL = new Set(["arm", "start", "reset", "jog", "plan"]);
const ALIVE_MS = 1000; // from one renewal of the lease to the next; the lease itself is 5 s
const KEYS = { a: "arm", s: "start", h: "hold", Escape: "stop", r: "reset" };

export class Commands {
  #connection;
  #buttons = new Map();
  #labels = new Map();
  #hello = null;
  #commandable = false;
  #confirming = null; // the command whose second press is awaited
  #confirmSince = 0;
  #confirmTimer = 0;
  #waiting = new Map(); // of unanswered commands: {timer, told}
  #arming = false;
  #othersControl = false;
  #aliveAt = -Infinity;
  #replayed = false;
  #next = 1;

  constructor(container, connection) {
    this.#connection = connection;
    for (const button of container.querySelectorAll("button")) {
      const { command } = button.dataset;
      this.#buttons.set(command, button);
      this.#labels.set(command, button.querySelector(".label").textContent);
      button.addEventListener("click", () => this.#press(command));
    }
    addEventListener("keydown", (event) => this.#key(event));
    document.getElementById("take").addEventListener("click", () => this.give("alive", { take: true }, (error) =>
      this.#say(error === null ? "This page has control." : `take control: ${error}`, error !== null)));
  }

  /** Renews this page's lease: called with every batch that comes, for timers of a hidden page do not run. */
  renew(now) {
    if (!this.operator || !this.#commandable || now - this.#aliveAt < ALIVE_MS) return;
    this.#aliveAt = now;
    this.give("alive", {}, () => {});
  }

  /** The server's first words, null when the connection is lost. */
  greet(hello) {
    this.#hello = hello;
    for (const [id, { timer }] of this.#waiting) if (!timer) this.#waiting.delete(id);
    this.#commandable &&= hello !== null;
    set("authority", !hello ? "" : hello.operator ? ""
      : "Watching only. To give commands, open the address that palmd view printed: it carries the token.");
  }

  /** Whether somebody takes commands. */
  reach(commandable) {
    this.#commandable = commandable;
  }

  /** Whether a command of that name can be given now: never by data that are stale or old. */
  applies(command, state, stale) {
    return Boolean(this.#hello?.operator && this.#commandable && !stale && !this.#replayed
      && !(this.#othersControl && NEEDS_CONTROL.has(command)) && this.#hello.allowed[command]?.includes(state));
  }

  get operator() {
    return Boolean(this.#hello?.operator);
  }

  /** Enables what does something in this state of the daemon. Stop does whenever that state is not known, too. */
  offer(store, stale, replayed) {
    this.#replayed = replayed;
    const { state, control = "", unattended = false } = store.get("palm/state");
    this.#showControl(stale ? "" : control, unattended && !stale);
    const { plan, arm_state: arm } = store.get("palm/motion");
    const idle = {
      start: state === "tracking" && (underWay(store) || !plan),
      hold: state === "hold",
      stop: !this.#arming && !["tracking", "hold"].includes(state) && !MOVED.includes(arm),
    };
    for (const [command, button] of this.#buttons) {
      const applies = command === "stop" && (stale || this.#arming || MOVED.includes(arm)) ? this.operator && !replayed
        : this.applies(command, state, stale) && !idle[command];
      put(button, "disabled", !applies);
      if (button.disabled && this.#confirming === command) {
        this.#forget();
        this.#say("", false);
      }
    }
    if (this.operator) {
      set("authority", replayed ? "A recorded run is shown: there is nothing to command."
        : this.#commandable ? "" : `Nobody takes commands at ${this.#hello.command}.`);
    }
  }

  /** Says which client has control, and offers to take it. */
  #showControl(control, unattended) {
    const ours = Boolean(control) && control === this.#hello?.client;
    this.#othersControl = Boolean(control) && !ours;
    const who = ours ? "Control: this page" : control ? `Control: ${control}` : unattended ? "Control: nobody" : "";
    set("control", unattended ? `${who} (unattended)` : who);
    const warning = unattended ? "No client with a lease watches over the motion." : "";
    put(document.getElementById("control"), "title", warning);
    const take = document.getElementById("take");
    put(take, "hidden", !(this.operator && this.#commandable && (this.#othersControl || (unattended && !ours))));
  }

  /** Gives a command; `told`, if any, gets the error or null, and the result, instead of the page's line, within `ms`. */
  give(command, args = {}, told = null, ms = ANSWER_MS) {
    const id = this.#next++;
    if (!this.#connection.order(id, command, args)) {
      if (told) told("not sent, there is no connection");
      else this.#say(`${command}: not sent, there is no connection`, true);
      return false;
    }
    if (!told) this.#say(`${command}…`, false);
    const silent = () => {
      this.answer({ id, cmd: command, error: "no answer from palmd view" });
      this.#waiting.set(id, { told: told && (() => {}), timer: 0 }); // who has been told so hears no more of it
    };
    this.#waiting.set(id, { told, timer: setTimeout(silent, ms) });
    return true;
  }

  /** What became of a command. */
  answer({ id, cmd, error, result }) {
    const { told, timer } = this.#waiting.get(id) ?? {};
    clearTimeout(timer);
    this.#waiting.delete(id);
    if (cmd === "arm") this.#arming = false;
    if (told) told(error, result);
    else this.tell(error === null ? `${cmd}: done` : error.startsWith(cmd) ? error : `${cmd}: ${error}`, error !== null);
  }

  /** Shows what became of something, on the page's line. */
  tell(text, bad = false) {
    this.#say(text, bad);
  }

  #press(command) {
    if (this.#confirming === command && performance.now() - this.#confirmSince < DOUBLE_CLICK_MS) return;
    if (GUARDED.has(command) && this.#confirming !== command) {
      this.#forget();
      this.#confirming = command;
      this.#confirmSince = performance.now();
      this.#buttons.get(command).classList.add("confirming");
      this.#label(command, "Press again");
      this.#say(`${command} moves the arm: press again within 3 s`, false);
      this.#confirmTimer = setTimeout(() => {
        this.#forget();
        this.#say("", false);
      }, CONFIRM_MS);
      return;
    }
    this.#forget();
    this.#arming = this.give(command) && command === "arm";
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
    if (event.key !== "Escape" && event.target.matches("input:not([type=range]), select, textarea")) return; // somebody writes
    const command = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    const sure = command === "stop" && this.operator; // what the page thinks of the state may be wrong
    if (!command || (this.#buttons.get(command).disabled && !sure)) return;
    event.preventDefault();
    this.#press(command);
  }

  #forget() {
    clearTimeout(this.#confirmTimer);
    if (this.#confirming) {
      this.#buttons.get(this.#confirming).classList.remove("confirming");
      this.#label(this.#confirming, this.#labels.get(this.#confirming));
    }
    this.#confirming = null;
  }

  #label(command, text) {
    this.#buttons.get(command).querySelector(".label").textContent = text;
  }

  #say(text, bad) {
    set("answer", text);
    document.getElementById("answer").classList.toggle("bad", bad);
  }
}
