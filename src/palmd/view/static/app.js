// The page: what comes goes into the store, and the store is drawn.

import { Commands } from "./commands.js";
import { Connection } from "./connection.js";
import { describe, layOut, set, showReadouts } from "./readouts.js";
import { Scene } from "./scene.js";
import { Store } from "./store.js";
import { Strips } from "./strips.js";
import { onColours } from "./theme.js";

const READOUT_MS = 100;
const DESCRIBE_MS = 3000;
const CALM_MS = 100; // between pictures for those who want less motion

layOut(document.getElementById("told"));
const store = new Store();
const scene = new Scene(document.getElementById("scene"));
const strips = new Strips(document.getElementById("strips"));
const calm = matchMedia("(prefers-reduced-motion: reduce)");
let connected = false;
let hello = null;
let drawnAt = -Infinity;
let frames = [];

const connection = new Connection({
  hello(said) {
    [connected, hello] = [true, said];
    commands.greet(said);
  },
  messages(came) {
    const now = performance.now();
    for (const [topic, fields] of came) store.take(topic, fields, now);
  },
  batch({ commandable }) {
    commands.reach(commandable);
  },
  answer(said) {
    commands.answer(said);
  },
  lost() {
    connected = false;
    commands.greet(null);
  },
});
const commands = new Commands(document.getElementById("commands"), connection);

function draw(now) {
  requestAnimationFrame(draw);
  if (calm.matches && now - drawnAt < CALM_MS) return;
  if (!scene.outdated && drawnAt > store.palmAt && store.stale(performance.now())) return; // nothing new
  frames.push(now);
  drawnAt = performance.now();
  scene.draw(store, drawnAt);
  strips.draw(store, calm.matches ? strips.length : 1);
}

function tell() {
  const now = performance.now();
  const stale = !connected || store.stale(now);
  frames = frames.filter((t) => t > now - 1000);
  showReadouts(store, now, frames.length);
  strips.tell(store);
  commands.offer(store, stale);
  showLegend(now);
  showStaleness(now, stale);
}

function showLegend(now) {
  document.getElementById("key-truth").hidden = !store.truthful(now);
  set("magnification", `×${scene.factor}`);
}

/** What is old is said to be, and looks it. */
function showStaleness(now, stale) {
  document.body.classList.toggle("stale", stale);
  const banner = document.getElementById("stale");
  banner.hidden = !stale;
  if (!stale) return;
  const heard = Number.isFinite(store.palmAt);
  set("stale-why", !connected ? "Stale: no connection to palmd view, trying again."
    : heard ? "Stale: palmd says nothing." : `Waiting for a palmd at ${hello.publish}.`);
  set("stale-age", heard ? `The picture is ${((now - store.palmAt) / 1000).toFixed(0)} s old.` : "");
}

document.getElementById("magnify").addEventListener("change", ({ target }) => scene.setMagnified(target.checked));
onColours(() => {
  scene.outdated = true;
  strips.recolour();
});
setInterval(tell, READOUT_MS);
setInterval(() => {
  document.getElementById("scene").setAttribute("aria-label", describe(store));
}, DESCRIBE_MS);
requestAnimationFrame(draw);
