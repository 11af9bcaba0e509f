// Strips: the last seconds of a quantity or two with ± one sigma, and below them by how much they differ from the truth.

import { ESTIMATE, STRIPS, told } from "./quantities.js";
import { element, number } from "./text.js";
import { SD, WINDOW_S } from "./store.js";
import { colours } from "./theme.js";

const STRIDE = 3; // 33 samples a second are as many as there are pixels
const LANE = 0.36; // of a strip's height, for the difference from the truth
const STEPS = [1, 2, 5, 10];

export class Strips {
  #groups = [];
  #strips;
  #turn = 0;

  constructor(container) {
    this.#strips = [...Map.groupBy(STRIPS, ({ group }) => group)].flatMap(([title, strips]) => {
      const group = element("section", "group");
      group.setAttribute("aria-label", title);
      this.#groups.push(group);
      group.append(element("h2", "", title));
      container.append(group);
      return strips.map((strip) => new Strip(group, strip));
    });
    new ResizeObserver(() => this.#strips.forEach((strip) => strip.resize())).observe(container);
  }

  /** Draws the next strip or two of the round: all at once would take a whole frame. */
  draw(store, count) {
    const shown = this.#strips.filter((strip) => !strip.hidden);
    for (let i = 0; i < Math.min(count, shown.length); i++) {
      this.#turn = (this.#turn + 1) % shown.length;
      shown[this.#turn].draw(store);
    }
  }

  get length() {
    return this.#strips.length;
  }

  /** Shows the strips of the system whose estimate is at hand. */
  #choose(estimate) {
    for (const strip of this.#strips) strip.choose(estimate);
    for (const group of this.#groups) {
      const count = group.querySelectorAll(".strip:not([hidden])").length;
      group.hidden = count === 0;
      group.classList.toggle("wide", count > 2);
    }
  }

  /** The numbers above the strips; whether there is a truth to differ from. */
  tell(store, truthful) {
    this.#choose(store.get("palm/estimate"));
    for (const strip of this.#strips) strip.tell(store.get("palm/estimate"), truthful);
  }

  recolour() {
    for (const strip of this.#strips) strip.rebuild();
  }
}

class Strip {
  #spec;
  #figure;
  #values = [];
  #verdict = null; // says whether the value is good
  #frame; // what the plot fills
  #plot;
  #range = [0, 1];
  #lane = null; // half the height of the lane in shown units; null without a truth
  #truthful = false;
  #newest = 0;
  #columns = []; // what was drawn last

  constructor(container, spec) {
    this.#spec = spec;
    this.#figure = element("figure", "strip");
    const caption = element("figcaption", "");
    caption.append(element("span", "title", spec.title));
    spec.names.forEach((name, i) => {
      const { symbol, meaning } = ESTIMATE[name];
      const value = element("span", "value");
      const one = element("span", "told");
      one.append(Object.assign(element("span", `name ${spec.colours[i]}`, symbol), { title: meaning }), value);
      caption.append(one);
      this.#values.push(value);
    });
    if (spec.unit) caption.append(element("span", "unit", spec.unit));
    if (spec.good) caption.append(this.#verdict = element("span", "verdict"));
    this.#frame = element("div", "plot");
    this.#figure.append(caption, this.#frame);
    container.append(this.#figure);
    this.#plot = this.#build();
  }

  get hidden() {
    return this.#figure.hidden;
  }

  choose(estimate) {
    const hidden = !told(this.#spec.names, estimate);
    if (hidden === this.hidden) return;
    this.#figure.hidden = hidden;
    if (!hidden) this.resize();
  }

  /** The last value of each curve with its sigma. */
  tell(estimate, truthful) {
    const { names, factor, digits } = this.#spec;
    names.forEach((name, i) => {
      const [value, sd] = [estimate[name] * factor, estimate.sd?.[name] * factor];
      const shown = estimate.valid || !ESTIMATE[name].uncertain;
      this.#values[i].textContent = !shown || !Number.isFinite(value) ? "–"
        : number(value, digits) + (Number.isFinite(sd) ? ` ± ${number(sd, digits + 1)}` : "");
    });
    if (this.#verdict) this.#judge(estimate[names[0]] * factor);
    if (truthful !== this.#truthful) {
      this.#truthful = truthful;
      if (names.some((name) => ESTIMATE[name].truth)) this.rebuild();
    }
  }

  #judge(value) {
    const { good: [low, high], digits } = this.#spec;
    const zone = high === null ? `good from ${number(low, digits)} on` : `good from ${number(low, digits)} to ${number(high, digits)}`;
    const outside = value < low || (high !== null && value > high);
    this.#verdict.textContent = Number.isFinite(value) ? `${outside ? "outside" : "inside"}: ${zone}` : zone;
    this.#verdict.dataset.outside = String(outside);
  }

  draw(store) {
    const { names, factor } = this.#spec;
    const { estimates } = store;
    if (Number.isNaN(estimates.newest)) return;
    this.#newest = estimates.newest;
    const since = estimates.newest - WINDOW_S;
    const x = estimates.times(since, STRIDE);
    const [curves, lanes] = [[], []];
    for (const name of names) {
      const value = estimates.values(name, since, STRIDE, factor);
      curves.push(value);
      if (!ESTIMATE[name].uncertain) continue;
      const sd = estimates.values(SD + name, since, STRIDE, factor);
      curves.push(combined(value, sd, 1), combined(value, sd, -1));
      if (!this.#compared(name)) continue;
      lanes.push(combined(value, truthOn(x, name, store, factor), -1), sd, sd.map((v) => (v === null ? null : -v)));
    }
    this.#range = this.#extent(curves);
    if (this.#lane !== null) this.#lane = tidy(lanes, this.#spec.digits);
    this.#columns = [x, ...curves, ...lanes];
    this.#plot.setData(this.#columns);
  }

  resize() {
    this.#plot.setSize(this.#size());
  }

  rebuild() {
    this.#plot.destroy();
    this.#plot = this.#build();
    if (this.#columns.length === this.#plot.series.length) this.#plot.setData(this.#columns);
  }

  #compared(name) {
    return this.#truthful && ESTIMATE[name].truth !== null;
  }

  /** The axis: all there is to see with some air, no less than the least span, and where the good zone begins. */
  #extent(columns) {
    const { span, low, good } = this.#spec;
    let [least, most] = extremes(columns);
    if (least > most) [least, most] = low === null ? [-span / 2, span / 2] : [low, low + span];
    if (good) most = Math.max(most, 1.4 * good[0]); // so that one sees where it would be good
    const air = Math.max((most - least) * 0.08, (span - (most - least)) / 2);
    return [low ?? least - air, most + air];
  }

  #build() {
    const { names, colours: own } = this.#spec;
    const points = { show: false };
    const series = [{}];
    const bands = [];
    const add = (name, scale, dash) => {
      const { symbol, uncertain } = ESTIMATE[name];
      const stroke = () => colours[own[names.indexOf(name)]] ?? colours.single;
      series.push({ label: symbol, scale, stroke, width: 1.5, dash, points });
      if (!uncertain) return;
      bands.push({ series: [series.length, series.length + 1], fill: () => `${stroke()}40` });
      series.push({ scale, points }, { scale, points });
    };
    for (const name of names) add(name, "y");
    const compared = names.filter((name) => this.#compared(name));
    for (const name of compared) add(name, "off");
    this.#lane = compared.length ? 1 : null;
    const axis = { stroke: () => colours.ink, font: "11px system-ui, sans-serif", ticks: { show: false } };
    const grid = { stroke: () => colours.faint, width: 1 };
    const axes = [
      { ...axis, grid, size: 18, gap: 2, splits: () => [-8, -6, -4, -2].map((s) => this.#newest + s),
        values: () => ["−8", "−6", "−4", "−2 s"] },
      { ...axis, grid, size: 46, gap: 4, space: 22, filter: (_, ticks) => ticks.map((t) => (t < this.#range[0] ? null : t)),
        values: (_, ticks) => ticks.map((tick) => (tick === null ? "" : minus(tick))) },
    ];
    if (this.#lane !== null) {
      axes.push({ ...axis, scale: "off", side: 1, grid, size: 46, gap: 4, splits: () => [-this.#lane, 0, this.#lane],
        filter: (_, ticks) => ticks, values: (_, ticks) => ticks.map((tick) => minus(Number(tick.toPrecision(3)))) });
    }
    return new uPlot({
      ...this.#size(),
      padding: [6, 6, 0, 0],
      cursor: { show: false },
      legend: { show: false },
      scales: {
        x: { time: false, range: () => [this.#newest - WINDOW_S, this.#newest] },
        y: { range: () => this.#above() },
        off: { range: () => this.#below() },
      },
      axes,
      series,
      bands,
      hooks: { drawClear: [(plot) => this.#drawZone(plot)] },
    }, [[], ...series.slice(1).map(() => [])], this.#frame);
  }

  /** The range of the axis with room for the lane below. */
  #above() {
    const [least, most] = this.#range;
    return this.#lane === null ? [least, most] : [least - ((most - least) * LANE) / (1 - LANE), most];
  }

  /** The range of the lane's axis, of which all but the lane is above. */
  #below() {
    const half = (this.#lane ?? 1) * 1.25;
    return [-half, half * (2 / LANE - 1)];
  }

  /** Where all is well. */
  #drawZone(plot) {
    if (!this.#spec.good) return;
    const [low, high] = this.#spec.good;
    const [top, bottom] = [high === null ? plot.bbox.top : plot.valToPos(high, "y", true), plot.valToPos(low, "y", true)];
    const upper = Math.max(top, plot.bbox.top);
    const lower = Math.min(bottom, plot.bbox.top + plot.bbox.height);
    if (!(lower > upper)) return;
    plot.ctx.fillStyle = colours["good-fill"];
    plot.ctx.fillRect(plot.bbox.left, upper, plot.bbox.width, lower - upper);
  }

  #size() {
    return { width: this.#frame.clientWidth, height: this.#frame.clientHeight };
  }
}

function minus(tick) {
  return String(tick).replace("-", "−");
}

function combined(a, b, sign) {
  return a.map((v, i) => (v === null || b[i] === null ? null : v + sign * b[i]));
}

function extremes(columns) {
  let [least, most] = [Infinity, -Infinity];
  for (const column of columns) {
    for (const value of column) {
      if (value === null) continue;
      if (value < least) least = value;
      if (value > most) most = value;
    }
  }
  return [least, most];
}

/** A round number (1, 2 or 5 times a power of ten) that no value of the columns exceeds. */
function tidy(columns, digits) {
  const [least, most] = extremes(columns);
  const largest = least > most ? 0 : Math.max(-least, most);
  const power = 10 ** Math.floor(Math.log10(Math.max(largest, 10 ** -digits)));
  return power * STEPS.find((step) => step * power >= largest);
}

/** The truth of a quantity at the times `x`; no values where there is no truth. */
function truthOn(x, name, store, factor) {
  const { truth } = ESTIMATE[name];
  if (truth === "rig/truth") return store.truths.valuesAt(x, name, factor);
  const constant = store.get(truth)[name];
  return x.map(() => (constant === undefined ? null : constant * factor));
}
