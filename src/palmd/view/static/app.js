// The page: what comes goes into the store, and the store is drawn.

import { ByHand } from "./byhand.js";
import { Commands } from "./commands.js";
import { Connection } from "./connection.js";
import { Console } from "./console.js";
import { showEvents } from "./events.js";
import { showHero, summary } from "./hero.js";
import { describe, layOut, showReadouts } from "./readouts.js";
import { Scene } from "./scene.js";
import { seconds, Store } from "./store.js";
import { Strips } from "./strips.js";
import { Tabs } from "./tabs.js";
import { element, put, set } from "./text.js";
import { chooseTheme, onColours } from "./theme.js";
import { Timeline } from "./timeline.js";

const OFFER_MS = 95; // between looks at what buttons do now: each third picture
const LATE_MS = 130; // the same without pictures
const READOUTS = 3; // looks, after which the numbers are written anew: each time costs a layout
const DESCRIBE_MS = 3000;
const CALM_MS = 100; // between pictures, for those who want less motion

layOut();
const store = new Store();
let wanted = true; // whether there is something new to be seen
const want = () => (wanted = true);
const scene = new Scene(document.getElementById("scene"), want);
const byName = (...names) => Object.fromEntries(names.map((name) => [name, document.getElementById(`window-${name}`)]));
const timeline = new Timeline(byName("span", "pause", "scrub", "cursor", "narrower", "wider", "says"), (share) => strips.point(share));
const strips = new Strips(document.getElementById("strips"), timeline, store);
const calm = matchMedia("(prefers-reduced-motion: reduce)");
let connected = false;
let ended = false; // by whoever served the page
let hello = null;
let [drawnAt, toldAt] = [-Infinity, -Infinity];
let frames = [];
let looks = 0;

const connection = new Connection({
  hello(said) {
    [connected, ended, hello] = [true, false, said];
    commands.greet(said);
    opened(view);
  },
  messages(came) {
    const now = performance.now();
    for (const [topic, fields] of came) {
      store.take(topic, fields, now);
      if (topic === "palm/log") log.take(fields, Date.now() / 1000 - seconds(fields));
    }
  },
  batch({ commandable }) {
    commands.reach(commandable);
    commands.renew(performance.now());
    want();
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
const library = (command, args, told, ms) => commands.give(command, args, told, ms);
const log = new Console();
const runs = opening(() => import("./runs.js"), ({ Runs }) => new Runs(library));
const configuration = opening(() => import("./configuration.js"), ({ Configuration: View }) => new View(library));
let view = "live";
const tabs = new Tabs(document.getElementById("tabs"), opened);

/** A view that is loaded when it is first opened. */
function opening(load, make) {
  let made = null;
  return () => (made ??= load().then(make));
}

/** A view has been opened: it shows what is so now. */
async function opened(name) {
  view = name;
  log.look(name === "log");
  want();
  if (name === "runs") (await runs()).list(hello);
  if (name === "configuration") (await configuration()).show();
}

/** A frame of the display. Words change with a picture where one comes, as the browser composes both at once. */
function frame(now) {
  requestAnimationFrame(frame); // always: to begin with frames again costs more than to be asked for nothing
  const pictured = wanted && view === "live" && !(calm.matches && now - drawnAt < CALM_MS);
  if (pictured) draw(now);
  if (now - toldAt < (pictured ? OFFER_MS : LATE_MS)) return;
  toldAt = now;
  tell();
}

function draw(now) {
  wanted = false;
  frames.push(now);
  drawnAt = now;
  scene.draw(store, drawnAt);
  strips.draw(store, calm.matches ? strips.length : 1, drawnAt);
}

function tell() {
  const now = performance.now();
  const stale = !connected || store.stale(now);
  const replayed = store.replayed(now);
  frames = frames.filter((t) => t > now - 1000);
  put(document.getElementById("replay"), "hidden", !replayed);
  commands.offer(store, stale, replayed);
  byHand.offer(store, stale);
  showStaleness(now, stale);
  if (ended || looks++ % READOUTS) return; // what was known in the end stays
  showReadouts(store, now, frames.length);
  showHero(store, now);
  showEvents(document.getElementById("events"), store.get("palm/log"), seconds(store.get("palm/estimate")));
  const truthful = store.truthful(now);
  strips.tell(store, truthful);
  showLegend(truthful);
}

function showLegend(truthful) {
  for (const id of ["key-truth", "lanes"]) put(document.getElementById(id), "hidden", !truthful);
  set("magnification", scene.factor ? `×${scene.factor}` : "");
}

/** What is old is said to be, and looks it. */
function showStaleness(now, stale) {
  const heard = Number.isFinite(store.palmAt);
  document.body.classList.toggle("stale", stale && !ended);
  document.body.classList.toggle("over", ended);
  put(document.getElementById("ended"), "hidden", !ended);
  put(document.getElementById("stale"), "hidden", !stale);
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
  want();
  strips.recolour();
});
document.getElementById("all-events").addEventListener("click", () => tabs.open("log"));
chooseTheme(document.getElementById("theme"));
setInterval(() => {
  document.getElementById("scene").setAttribute("aria-label", describe(store));
}, DESCRIBE_MS);
requestAnimationFrame(frame);
