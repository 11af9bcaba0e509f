// The socket to `palmd view`: sends the token, passes on messages, and reconnects automatically.

import { decode } from "./msgpack.js";

const RECONNECT_MS = [250, 500, 1000, 2000];
const GOING_AWAY = 1001; // close code of a server that was stopped
const TOKEN = "palmd-token";
const PAGE = "palmd-page";

/** The id of this tab, kept over reloads so that it keeps its control. */
function pageId() {
  if (!sessionStorage.getItem(PAGE)) sessionStorage.setItem(PAGE, Math.random().toString(36).slice(2, 8) || "0");
  return sessionStorage.getItem(PAGE);
}

/** The token from the address, kept for this tab over reloads; null for none. */
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
    socket.onopen = () => socket.send(JSON.stringify({ token: this.#token, page: pageId() }));
    socket.onmessage = ({ data }) => this.#take(data);
    socket.onclose = ({ code }) => {
      this.#on.lost(code === GOING_AWAY);
      setTimeout(() => this.#open(), RECONNECT_MS[Math.min(this.#attempt++, RECONNECT_MS.length - 1)]);
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
        // foreign data on one of our topics
      }
    }
    this.#on.messages(messages);
    this.#on.batch({ commandable, lost });
  }
}
