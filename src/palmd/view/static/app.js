// The page: what comes goes into the store, and the store is drawn.

import { ByHand } from "./byhand.js";
import { Commands } from "./commands.js";
import { Connection } from "./connection.js";
import { showEvents } from "./events.js";
import { showHero, summary } from "./hero.js";
import { describe, layOut, showReadouts } from "./readouts.js";
import { Scene } from "./scene.js";
import { seconds, Store } from "./store.js";
import { Strips } from "./strips.js";
import { element, set } from "./text.js";
import { onColours } from "./theme.js";

const READOUT_MS = 100;
const DESCRIBE_MS = 3000;
const CALM_MS = 100; // between pictures for those who want less motion

layOut();
const store = new Store();
const scene = new Scene(document.getElementById("scene"));
const strips = new Strips(document.getElementById("strips"));
const calm = matchMedia("(prefers-reduced-motion: reduce)");
let connected = false;
let ended = false; // by whoever served the page
let hello = null;
let drawnAt = -Infinity;
let frames = [];

const connection = new Connection({
  hello(said) {
    [connected, ended, hello] = [true, false, said];
    commands.greet(said);
  },
  messages(came) {
    const now = performance.now();
    for (const [topic, fields] of came) store.take(topic, fields, now);
  },
  batch({ commandable }) {
    commands.reach(commandable);
    commands.renew(performance.now());
  },
  answer(said) {
    commands.answer(said);
  },
  lost(over) {
    if (over) showSummary();
    [connected, ended] = [false, ended || over];
    commands.greet(null);
  },
});
const commands = new Commands(document.getElementById("commands"), connection);
const byHand = new ByHand(document.getElementById("by-hand"), commands);

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
  const replayed = store.replayed(now);
  frames = frames.filter((t) => t > now - 1000);
  document.getElementById("replay").hidden = !replayed;
  commands.offer(store, stale, replayed);
  byHand.offer(store, stale);
  showStaleness(now, stale);
  if (ended) return; // what was known in the end stays
  showReadouts(store, now, frames.length);
  showHero(store, now);
  showEvents(document.getElementById("events"), store.get("palm/log"), seconds(store.get("palm/estimate")));
  const truthful = store.truthful(now);
  strips.tell(store, truthful);
  showLegend(truthful);
}

function showLegend(truthful) {
  document.getElementById("key-truth").hidden = document.getElementById("lanes").hidden = !truthful;
  set("magnification", scene.factor ? `×${scene.factor}` : "");
}

/** What is old is said to be, and looks it. */
function showStaleness(now, stale) {
  const heard = Number.isFinite(store.palmAt);
  document.body.classList.toggle("stale", stale && !ended);
  document.body.classList.toggle("over", ended);
  document.getElementById("ended").hidden = !ended;
  document.getElementById("stale").hidden = !stale;
  if (!stale) return;
  set("stale-why", ended ? "Over: whoever served this page has ended it."
    : !connected ? "Stale: no connection to palmd view, trying again."
    : heard ? "Stale: palmd says nothing." : `Waiting for a palmd at ${hello.publish}.`);
  set("stale-age", heard ? `The picture is ${((now - store.palmAt) / 1000).toFixed(0)} s old.` : "");
}

/** What has come of it, in the end. */
function showSummary() {
  set("state", "over");
  document.getElementById("state").dataset.state = "unknown";
  set("state-means", "");
  set("ended-title", store.has("rig/object") ? "The demo has ended" : "palmd view has ended");
  document.getElementById("summary").replaceChildren(...summary(store, store.palmAt).flatMap(([what, found]) =>
    [element("dt", "", what), element("dd", "", found)]));
}

document.getElementById("magnify").addEventListener("change", ({ target }) => scene.setLens(target.checked));
onColours(() => {
  scene.outdated = true;
  strips.recolour();
});
setInterval(tell, READOUT_MS);
setInterval(() => {
  document.getElementById("scene").setAttribute("aria-label", describe(store));
}, DESCRIBE_MS);
requestAnimationFrame(draw);
