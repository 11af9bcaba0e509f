// The socket to `palmd view`: shows the token, hands on what comes, and connects again by itself.

import { decode } from "./msgpack.js";

const AGAIN_MS = [250, 500, 1000, 2000];
const GOING_AWAY = 1001; // the server has been ended, not lost
const TOKEN = "palmd-token";
const PAGE = "palmd-page";

/** By what this tab is known again when it is loaded anew, so that it keeps the control that it had. */
function page() {
  if (!sessionStorage.getItem(PAGE)) sessionStorage.setItem(PAGE, Math.random().toString(36).slice(2, 8) || "0");
  return sessionStorage.getItem(PAGE);
}

/** The token from the address, kept for this tab so that a reload still has it; null for none. */
function token() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem(TOKEN, given);
    history.replaceState(null, "", location.pathname); // no token in bookmarks and screenshots
  }
  return sessionStorage.getItem(TOKEN);
}

/** `on` has hello(map), messages([[topic, map]…]), batch({commandable, lost}), answer(map), lost(ended). */
export class Connection {
  #on;
  #token = token();
  #attempt = 0;
  #socket = null;

  constructor(on) {
    this.#on = on;
    addEventListener("hashchange", () => {
      this.#token = token();
      this.#socket?.close();
    });
    this.#open();
  }

  /** Sends a command; false when there is no connection to send it on. */
  order(id, cmd, args) {
    if (this.#socket?.readyState !== WebSocket.OPEN) return false;
    this.#socket.send(JSON.stringify({ id, cmd, args }));
    return true;
  }

  #open() {
    const socket = new WebSocket(`ws://${location.host}/socket`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => socket.send(JSON.stringify({ token: this.#token, page: page() }));
    socket.onmessage = ({ data }) => this.#take(data);
    socket.onclose = ({ code }) => {
      this.#on.lost(code === GOING_AWAY);
      setTimeout(() => this.#open(), AGAIN_MS[Math.min(this.#attempt++, AGAIN_MS.length - 1)]);
    };
    this.#socket = socket;
  }

  #take(data) {
    if (typeof data === "string") {
      const message = JSON.parse(data);
      if (message.hello) {
        this.#attempt = 0;
        this.#on.hello(message.hello);
      }
      if (message.answer) this.#on.answer(message.answer);
      return;
    }
    const [, lost, commandable, raw] = decode(new Uint8Array(data));
    const messages = [];
    for (const [topic, payload] of raw) {
      try {
        messages.push([topic, decode(payload)]);
      } catch {
        // somebody else's bytes on a topic of ours
      }
    }
    this.#on.messages(messages);
    this.#on.batch({ commandable, lost });
  }
}
