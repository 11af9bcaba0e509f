// The page: messages go into the store, and views are drawn from the store.

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

// Period of updates of buttons and texts: each second picture
const UPDATE_MS = 95;
const UPDATE_WITHOUT_PICTURE_MS = 130;
// The numbers change at every third update, as each change costs a layout
const READOUTS = 3;
const DESCRIBE_MS = 3000;
// Period of pictures for users who prefer reduced motion
const CALM_MS = 100;

layOut();
const store = new Store();
// Whether the picture is out of date
let dirty = true;
let requested = false; // a frame of the display
let view = "live";
const scene = new Scene(document.getElementById("scene"), redraw);
const byName = (...names) => Object.fromEntries(names.map((name) => [name, document.getElementById(`window-${name}`)]));
const timeline = new Timeline(byName("span", "pause", "scrub", "cursor", "narrower", "wider", "label"), (fraction) => strips.point(fraction));
const strips = new Strips(document.getElementById("strips"), timeline, store);
const calm = matchMedia("(prefers-reduced-motion: reduce)");
let connected = false;
let ended = false; // the server has been stopped
let hello = null;
let [drawnAt, updatedAt] = [-Infinity, -Infinity];
let frames = [];
let updates = 0;

const connection = new Connection({
  hello(message) {
    [connected, ended, hello] = [true, false, message];
    commands.setHello(message);
    opened(view);
  },
  messages(received) {
    const now = performance.now();
    for (const [topic, fields] of received) {
      store.take(topic, fields, now);
      if (topic === "palm/log") log.take(fields, Date.now() / 1000 - seconds(fields));
    }
  },
  batch({ commandable }) {
    commands.setCommandable(commandable);
    commands.renew(performance.now());
    redraw();
  },
  answer(message) {
    commands.answer(message);
  },
  lost(stopped) {
    if (stopped) showSummary();
    [connected, ended] = [false, ended || stopped];
    commands.setHello(null);
  },
});
const commands = new Commands(document.getElementById("commands"), connection);
const byHand = new ByHand(document.getElementById("by-hand"), commands);
const library = (command, args, onAnswer, ms) => commands.give(command, args, onAnswer, ms);
const log = new Console();
const runs = opening(() => import("./runs.js"), ({ Runs }) => new Runs(library));
const configuration = opening(() => import("./configuration.js"), ({ Configuration: View }) => new View(library));
const tabs = new Tabs(document.getElementById("tabs"), opened);

/** A function that loads and makes a view when it is first called. */
function opening(load, make) {
  let made = null;
  return () => (made ??= load().then(make));
}

/** Called when a view is opened: updates it. */
async function opened(name) {
  view = name;
  log.setVisible(name === "log");
  redraw();
  if (name === "runs") (await runs()).list(hello);
  if (name === "configuration") (await configuration()).show();
}

/** Marks the picture as out of date; called for each batch, so that the server's rate of batches limits the pictures. */
function redraw() {
  dirty = true;
  if (view === "live") request();
}

/** Requests one frame: idle frames cost the browser as much as the texts. */
function request() {
  if (!requested) requestAnimationFrame(frame);
  requested = true;
}

/** A frame of the display. Texts are updated together with a picture if possible, as the browser composes both at once. */
function frame(now) {
  requested = false;
  const pictured = dirty && view === "live" && !(calm.matches && now - drawnAt < CALM_MS);
  if (pictured) draw(now);
  if (now - updatedAt < (pictured ? UPDATE_MS : UPDATE_WITHOUT_PICTURE_MS)) return;
  updatedAt = now;
  update();
}

function draw(now) {
  dirty = false;
  frames.push(now);
  drawnAt = now;
  scene.draw(store, drawnAt);
  strips.draw(store, drawnAt);
}

function update() {
  const now = performance.now();
  const stale = !connected || store.stale(now);
  const replayed = store.replayed(now);
  frames = frames.filter((t) => t > now - 1000);
  put(document.getElementById("replay"), "hidden", !replayed);
  commands.offer(store, stale, replayed);
  byHand.offer(store, stale);
  showStaleness(now, stale);
  if (ended || updates++ % READOUTS) return; // after the end the last values stay
  showReadouts(store, now, frames.length);
  showHero(store, now);
  showEvents(document.getElementById("events"), store.get("palm/log"), seconds(store.get("palm/estimate")));
  const truthful = store.truthful(now);
  strips.update(store, truthful);
  showLegend(truthful);
}

function showLegend(truthful) {
  for (const id of ["key-truth", "lanes"]) put(document.getElementById(id), "hidden", !truthful);
  set("magnification", scene.factor ? `×${scene.factor}` : "");
}

/** Marks old data. */
function showStaleness(now, stale) {
  const received = Number.isFinite(store.palmAt);
  document.body.classList.toggle("stale", stale && !ended);
  document.body.classList.toggle("over", ended);
  put(document.getElementById("ended"), "hidden", !ended);
  put(document.getElementById("stale"), "hidden", !stale);
  if (!stale) return;
  set("stale-why", ended ? "Disconnected: the server stopped."
    : !connected ? "Stale: no connection to palmd view, reconnecting."
    : received ? "Stale: no data from palmd." : `Waiting for palmd at ${hello.publish}.`);
  set("stale-age", received ? `The picture is ${((now - store.palmAt) / 1000).toFixed(0)} s old.` : "");
}

/** Shows the final result. */
function showSummary() {
  set("state", "over");
  document.getElementById("state").dataset.state = "unknown";
  set("state-means", "");
  set("ended-title", store.has("rig/object") ? "The demo has ended" : "palmd view has ended");
  document.getElementById("summary").replaceChildren(...summary(store, store.palmAt).flatMap(([name, value]) =>
    [element("dt", "", name), element("dd", "", value)]));
}

document.getElementById("magnify").addEventListener("change", ({ target }) => scene.setLens(target.checked));
onColours(() => {
  redraw();
  strips.recolour();
});
document.getElementById("all-events").addEventListener("click", () => tabs.open("log"));
chooseTheme(document.getElementById("theme"));
setInterval(() => {
  document.getElementById("scene").setAttribute("aria-label", describe(store));
}, DESCRIBE_MS);
setInterval(() => {
  if (performance.now() - updatedAt >= UPDATE_WITHOUT_PICTURE_MS) request();
}, UPDATE_WITHOUT_PICTURE_MS);
request();
