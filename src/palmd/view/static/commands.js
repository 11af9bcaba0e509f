// The command buttons: which of them apply, confirmation of arm and start by a second press, keys, and answers.

import { planRunning } from "./knowledge.js";
import { put, set } from "./text.js";

const CONFIRM_MS = 3000;
// Two presses within this time count as one
const DOUBLE_CLICK_MS = 350;
// The server itself gives up after 2 s
const ANSWER_MS = 2500;
// States of the arm in which it can be stopped
const MOVING_STATES = ["T", "H", "D"];
const GUARDED = new Set(["arm", "start"]);
const NEEDS_CONTROL = new Set(["arm", "start", "reset", "jog", "plan"]);
// Period of lease renewals; the lease lasts 5 s
const RENEW_MS = 1000;
const KEYS = { a: "arm", s: "start", h: "hold", Escape: "stop", r: "reset" };

export class Commands {
  #connection;
  #buttons = new Map();
  #labels = new Map();
  #hello = null;
  #commandable = false;
  // The command that waits for its second press
  #confirming = null;
  #confirmSince = 0;
  #confirmTimer = 0;
  // Unanswered commands by id: {timer, onAnswer}
  #waiting = new Map();
  #arming = false;
  #controlledElsewhere = false;
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
      this.#showAnswer(error === null ? "This page has control." : `take control: ${error}`, error !== null)));
  }

  /** Renews this page's lease; called with every batch, as timers of a hidden page do not run. */
  renew(now) {
    if (!this.operator || !this.#commandable || now - this.#aliveAt < RENEW_MS) return;
    this.#aliveAt = now;
    this.give("alive", {}, () => {});
  }

  /** Sets the server's first message, null without a connection. */
  setHello(hello) {
    this.#hello = hello;
    for (const [id, { timer }] of this.#waiting) if (!timer) this.#waiting.delete(id);
    this.#commandable &&= hello !== null;
    set("authority", !hello ? "" : hello.operator ? ""
      : "Read-only. To send commands, open the address that palmd view printed: it contains the token.");
  }

  /** Sets whether a daemon accepts commands. */
  setCommandable(commandable) {
    this.#commandable = commandable;
  }

  /** Whether a command can be given now; never while data are stale or replayed. */
  applies(command, state, stale) {
    return Boolean(this.#hello?.operator && this.#commandable && !stale && !this.#replayed
      && !(this.#controlledElsewhere && NEEDS_CONTROL.has(command)) && this.#hello.allowed[command]?.includes(state));
  }

  get operator() {
    return Boolean(this.#hello?.operator);
  }

  /** Enables the buttons that apply in this state of the daemon. Stop is enabled also if the state is unknown. */
  offer(store, stale, replayed) {
    this.#replayed = replayed;
    const { state, control = "", unattended = false } = store.get("palm/state");
    this.#showControl(stale ? "" : control, unattended && !stale);
    const { plan, arm_state: arm } = store.get("palm/motion");
    const idle = {
      start: state === "tracking" && (planRunning(store) || !plan),
      hold: state === "hold",
      stop: !this.#arming && !["tracking", "hold"].includes(state) && !MOVING_STATES.includes(arm),
    };
    for (const [command, button] of this.#buttons) {
      const applies = command === "stop" && (stale || this.#arming || MOVING_STATES.includes(arm)) ? this.operator && !replayed
        : this.applies(command, state, stale) && !idle[command];
      put(button, "disabled", !applies);
      if (button.disabled && this.#confirming === command) {
        this.#cancelConfirmation();
        this.#showAnswer("", false);
      }
    }
    if (this.operator) {
      set("authority", replayed ? "Replay of a recorded run: commands are disabled."
        : this.#commandable ? "" : `No daemon accepts commands at ${this.#hello.command}.`);
    }
  }

  /** Shows which client has control, and offers to take it. */
  #showControl(control, unattended) {
    const ours = Boolean(control) && control === this.#hello?.client;
    this.#controlledElsewhere = Boolean(control) && !ours;
    const owner = ours ? "Control: this page" : control ? `Control: ${control}` : unattended ? "Control: none" : "";
    set("control", unattended ? `${owner} (unattended)` : owner);
    const warning = unattended ? "No client with a lease supervises the motion." : "";
    put(document.getElementById("control"), "title", warning);
    const take = document.getElementById("take");
    put(take, "hidden", !(this.operator && this.#commandable && (this.#controlledElsewhere || (unattended && !ours))));
  }

  /** Sends a command; `onAnswer(error, result)`, if given, replaces the answer line; `error` is null on success. Timeout `ms`. */
  give(command, args = {}, onAnswer = null, ms = ANSWER_MS) {
    const id = this.#next++;
    if (!this.#connection.order(id, command, args)) {
      if (onAnswer) onAnswer("not sent, there is no connection");
      else this.#showAnswer(`${command}: not sent, there is no connection`, true);
      return false;
    }
    if (!onAnswer) this.#showAnswer(`${command}…`, false);
    const silent = () => {
      this.answer({ id, cmd: command, error: "no answer from palmd view" });
      this.#waiting.set(id, { onAnswer: onAnswer && (() => {}), timer: 0 }); // ignore a late answer
    };
    this.#waiting.set(id, { onAnswer, timer: setTimeout(silent, ms) });
    return true;
  }

  /** Handles the answer to a command. */
  answer({ id, cmd, error, result }) {
    const { onAnswer, timer } = this.#waiting.get(id) ?? {};
    clearTimeout(timer);
    this.#waiting.delete(id);
    if (cmd === "arm") this.#arming = false;
    if (onAnswer) onAnswer(error, result);
    else this.show(error === null ? `${cmd}: done` : error.startsWith(cmd) ? error : `${cmd}: ${error}`, error !== null);
  }

  /** Shows a text on the answer line. */
  show(text, bad = false) {
    this.#showAnswer(text, bad);
  }

  #press(command) {
    if (this.#confirming === command && performance.now() - this.#confirmSince < DOUBLE_CLICK_MS) return;
    if (GUARDED.has(command) && this.#confirming !== command) {
      this.#cancelConfirmation();
      this.#confirming = command;
      this.#confirmSince = performance.now();
      this.#buttons.get(command).classList.add("confirming");
      this.#label(command, "Press again");
      this.#showAnswer(`${command} moves the arm: press again within 3 s`, false);
      this.#confirmTimer = setTimeout(() => {
        this.#cancelConfirmation();
        this.#showAnswer("", false);
      }, CONFIRM_MS);
      return;
    }
    this.#cancelConfirmation();
    this.#arming = this.give(command) && command === "arm";
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
    if (event.key !== "Escape" && event.target.matches("input:not([type=range]), select, textarea")) return; // the user is typing
    const command = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    // The page's state may be outdated
    const always = command === "stop" && this.operator;
    if (!command || (this.#buttons.get(command).disabled && !always)) return;
    event.preventDefault();
    this.#press(command);
  }

  #cancelConfirmation() {
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

  #showAnswer(text, bad) {
    set("answer", text);
    document.getElementById("answer").classList.toggle("bad", bad);
  }
}
