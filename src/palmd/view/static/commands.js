// The command buttons: which of them apply, the second press that arm and start need, keys, and the answers.

import { set } from "./readouts.js";

const CONFIRM_MS = 3000;
const DOUBLE_CLICK_MS = 350; // two presses within it are one
const ANSWER_MS = 2500; // the server itself gives up after 2 s
const GUARDED = new Set(["arm", "start"]);
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
  #waiting = new Map(); // timers of unanswered commands
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
  }

  /** The server's first words, null when the connection is lost. */
  greet(hello) {
    this.#hello = hello;
    this.#commandable &&= hello !== null;
    set("authority", !hello ? "" : hello.operator ? ""
      : "Watching only. To give commands, open the address that palmd view printed: it carries the token.");
  }

  /** Whether somebody takes commands. */
  reach(commandable) {
    this.#commandable = commandable;
  }

  /** Enables what applies in this state of the daemon; a guess from stale data is none. */
  offer(store, stale) {
    const { state } = store.get("palm/state");
    const { segment = -1 } = store.get("palm/motion");
    for (const [command, button] of this.#buttons) {
      const moving = command === "start" && state === "tracking" && segment >= 0;
      const applies = command === "stop"
        || (!stale && this.#commandable && !moving && this.#hello?.allowed[command]?.includes(state));
      button.disabled = !(this.#hello?.operator && applies);
      if (button.disabled && this.#confirming === command) {
        this.#forget();
        this.#say("", false);
      }
    }
    if (this.#hello?.operator) {
      set("authority", this.#commandable ? "" : `Nobody takes commands at ${this.#hello.command}.`);
    }
  }

  /** What became of a command. */
  answer({ id, cmd, error }) {
    clearTimeout(this.#waiting.get(id));
    this.#waiting.delete(id);
    this.#say(error === null ? `${cmd}: done` : `${cmd}: ${error}`, error !== null);
  }

  #press(command) {
    if (this.#confirming === command && performance.now() - this.#confirmSince < DOUBLE_CLICK_MS) return;
    if (GUARDED.has(command) && this.#confirming !== command) {
      this.#forget();
      this.#confirming = command;
      this.#confirmSince = performance.now();
      this.#buttons.get(command).classList.add("confirming");
      this.#label(command, `Press again to ${command}`);
      this.#say(`${command} moves the arm: press again within 3 s`, false);
      this.#confirmTimer = setTimeout(() => {
        this.#forget();
        this.#say("", false);
      }, CONFIRM_MS);
      return;
    }
    this.#forget();
    const id = this.#next++;
    if (!this.#connection.order(id, command)) {
      this.#say(`${command}: not sent, there is no connection`, true);
      return;
    }
    this.#say(`${command}…`, false);
    const silence = { id, cmd: command, error: "no answer from palmd view" };
    this.#waiting.set(id, setTimeout(() => this.answer(silence), ANSWER_MS));
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || event.repeat) return;
    const command = KEYS[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!command || this.#buttons.get(command).disabled) return;
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
