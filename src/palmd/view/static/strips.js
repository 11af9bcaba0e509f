// Strips: plots of quantities over a time window with ± 1 sd, limits, and differences from the truth.

import { ESTIMATE, LISTED, STRIPS, hasAny } from "./quantities.js";
import { element, number, put } from "./text.js";
import { SD } from "./store.js";
import { colours } from "./theme.js";

// 33 samples per second, about one per pixel
const STRIDE = 3;
// Fraction of a strip's height for the difference from the truth
const LANE = 0.36;
const STEPS = [1, 2, 5, 10];
// A narrower selection is a click
const SELECTED_PX = 8;
const CURSORS = "strips"; // key of the shared cursor
// Period of redrawing the plots, all in one picture: others then change only the scene
const ROUND_MS = 190;

export class Strips {
  #groups = [];
  #strips;
  #drawnAt = -Infinity; // ms
  #timeline;

  constructor(container, timeline, store) {
    this.#timeline = timeline;
    this.#strips = [...Map.groupBy(STRIPS, ({ group }) => group)].flatMap(([title, strips]) => {
      const group = element("section", "group");
      group.setAttribute("aria-label", title);
      this.#groups.push(group);
      group.append(element("h2", "", title));
      container.append(group);
      return strips.map((strip) => new Strip(group, strip, timeline));
    });
    new ResizeObserver(() => this.#strips.forEach((strip) => strip.resize())).observe(container);
    const watcher = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) {
        const strip = this.#strips.find(({ figure }) => figure === target);
        strip.inView = isIntersecting;
        if (isIntersecting) strip.draw(store); // the run may be over, without further draws
      }
    });
    for (const { figure } of this.#strips) watcher.observe(figure);
  }

  /** Draws the visible plots at `now` (ms) if the last time is long enough ago. */
  draw(store, now) {
    if (now - this.#drawnAt < ROUND_MS) return;
    this.#drawnAt = now;
    this.#timeline.reach(Math.min(store.estimates.oldest, store.run.oldest), store.estimates.newest);
    for (const strip of this.#strips) if (strip.inView && !strip.hidden) strip.draw(store);
  }

  /** Shows the strips of the system of the current estimate. */
  #choose(estimate, store) {
    for (const alike of Map.groupBy(this.#strips, ({ title }) => title).values()) {
      const fits = alike.map((strip) => strip.fit(estimate, store));
      const best = Math.max(...fits);
      alike.forEach((strip, i) => strip.choose(best > 0 && i === fits.indexOf(best), estimate));
    }
    for (const group of this.#groups) {
      const count = group.querySelectorAll(".strip:not([hidden])").length;
      put(group, "hidden", count === 0);
      group.classList.toggle("wide", count > 2);
    }
  }

  /** Updates the numbers above the strips; `truthful`: whether the truth is known. */
  update(store, truthful) {
    this.#choose(store.get("palm/estimate"), store);
    for (const strip of this.#strips) strip.update(store, truthful);
    this.#timeline.update(this.#strips.find((strip) => !strip.hidden)?.cursor ?? NaN);
  }

  /** Puts the cursor of all plots at a fraction of their width, 0…1. */
  point(share) {
    this.#strips.find((strip) => !strip.hidden)?.point(share);
  }

  recolour() {
    for (const strip of this.#strips) strip.rebuild();
  }
}

class Strip {
  figure = element("figure", "strip");
  inView = false;
  #spec;
  #values = [];
  // Element that shows whether the value is within its limits
  #verdict = null;
  #frame; // container of the plot
  #plot;
  #range = [0, 1];
  // Half the height of the lane in displayed units; null without a truth
  #lane = null;
  #truthful = false;
  #columns = []; // last drawn data
  #timeline;
  #limits = []; // in displayed units

  constructor(container, spec, timeline) {
    [this.#spec, this.#timeline] = [spec, timeline];
    const caption = element("figcaption", "");
    caption.append(element("span", "title", spec.title));
    spec.names.forEach((name, i) => {
      const { symbol, meaning } = ESTIMATE[name];
      const value = element("span", "value");
      const readout = element("span", "readout");
      readout.append(Object.assign(element("span", `name ${spec.colours[i]}`, symbol), { title: meaning }), value);
      caption.append(readout);
      this.#values.push(value);
    });
    if (spec.unit) caption.append(element("span", "unit", spec.unit));
    if (spec.good || spec.limit) caption.append(this.#verdict = element("span", "verdict"));
    this.#frame = element("div", "plot");
    this.figure.append(caption, this.#frame);
    container.append(this.figure);
    this.#plot = this.#build();
  }

  get hidden() {
    return this.figure.hidden;
  }

  get title() {
    return this.#spec.title;
  }

  /** The number of its quantities in the estimate. */
  fit(estimate, store) {
    const { names, limit } = this.#spec;
    return limit?.listed ? store.get(limit.topic)[limit.listed]?.length ?? 0 : names.filter((name) => hasAny([name], estimate)).length;
  }

  /** Shows or hides the strip and the names of its quantities. */
  choose(shown, estimate) {
    const { names, limit } = this.#spec;
    if (shown && !limit?.listed) names.forEach((name, i) => put(this.#values[i].parentElement, "hidden", !hasAny([name], estimate)));
    const hidden = !shown;
    if (hidden === this.hidden) return;
    this.figure.hidden = hidden;
    if (!hidden) this.resize();
  }

  /** Updates the value and standard deviation of each curve, at the cursor or now. */
  update(store, truthful) {
    const estimate = store.get("palm/estimate");
    const { names, factor, digits } = this.#spec;
    this.#limits = this.#limitsIn(store);
    const at = this.#plot.cursor.left >= 0 ? this.#plot.cursor.idx : null;
    names.forEach((name, i) => {
      const [value, sd] = at !== null ? this.#at(i, at)
        : estimate.valid || !ESTIMATE[name].uncertain ? [this.#now(name, store) * factor, estimate.sd?.[name] * factor] : [NaN, NaN];
      const text = !Number.isFinite(value) ? "–" : number(value, digits) + (Number.isFinite(sd) ? ` ± ${number(sd, digits + 1)}` : "");
      put(this.#values[i], "textContent", text);
    });
    if (this.#verdict) this.#judge(names.map((name) => this.#now(name, store) * factor));
    if (truthful !== this.#truthful) {
      this.#truthful = truthful;
      if (names.some((name) => ESTIMATE[name].truth)) this.rebuild();
    }
  }

  /** The time at the cursor (s), NaN without a cursor. */
  get cursor() {
    return this.#plot.cursor.left >= 0 ? this.#plot.posToVal(this.#plot.cursor.left, "x") : NaN;
  }

  /** Puts the cursor at a fraction of the width, 0…1. */
  point(share) {
    this.#plot.setCursor({ left: share * this.#plot.over.clientWidth, top: 0 }, true, true);
  }

  #now(name, store) {
    const listed = LISTED.find((each) => each.name === name);
    return listed ? store.listed(listed) : store.get("palm/estimate")[name];
  }

  /** Value and standard deviation of the i-th quantity at row `at`, in displayed units. */
  #at(i, at) {
    const { names } = this.#spec;
    const column = 1 + names.slice(0, i).reduce((sum, name) => sum + (ESTIMATE[name].uncertain ? 3 : 1), 0);
    const value = this.#columns[column]?.[at] ?? NaN;
    const above = ESTIMATE[names[i]].uncertain ? this.#columns[column + 1]?.[at] ?? NaN : NaN;
    return [value, above - value];
  }

  /** The limits of the quantities, in displayed units. */
  #limitsIn(store) {
    const { limit, good, factor } = this.#spec;
    if (good) return good.filter((end) => end !== null);
    const found = limit ? [store.get(limit.topic)[limit.name] ?? []].flat() : [];
    return [...new Set(found.filter(Number.isFinite))].map((each) => each * factor);
  }

  #judge(values) {
    const { good, digits, low } = this.#spec;
    const known = values.filter(Number.isFinite);
    let [text, outside] = ["", false];
    if (good) {
      const [least, most] = good;
      outside = known.some((value) => value < least || (most !== null && value > most));
      text = most === null ? `limit: at least ${number(least, digits)}` : `limits ${number(least, digits)} to ${number(most, digits)}`;
    } else if (this.#limits.length) {
      const most = Math.min(...this.#limits);
      outside = known.some((value) => Math.abs(value) > most);
      text = `limit ${low === null ? "±\u00a0" : ""}${number(most, digits)}`;
    } else {
      text = "limit not published";
    }
    const words = known.length && this.#limits.length ? `${outside ? "outside" : "inside"}: ${text}` : text;
    put(this.#verdict, "textContent", words);
    put(this.#verdict.dataset, "outside", String(outside));
  }

  draw(store) {
    const { names, factor } = this.#spec;
    if (Number.isNaN(store.estimates.newest)) return;
    const { times: x, values, whole } = store.cut(...this.#timeline.window, this.#timeline.live ? STRIDE : 1);
    const [curves, lanes] = [[], []];
    for (const name of names) {
      const value = values(name, factor);
      curves.push(value);
      if (!ESTIMATE[name].uncertain) continue;
      const sd = values(SD + name, factor);
      curves.push(combined(value, sd, 1), combined(value, sd, -1));
      if (!this.#compared(name)) continue;
      const truth = whole ? truthOn(x, name, store, factor) : x.map(() => null);
      lanes.push(combined(value, truth, -1), sd, sd.map((v) => (v === null ? null : -v)));
    }
    this.#range = this.#extent(curves);
    if (this.#lane !== null) this.#lane = roundLimit(lanes, this.#spec.digits);
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
    return this.#truthful && Boolean(ESTIMATE[name].truth);
  }

  /** The range of the y axis: all data with a margin, at least the smallest span, and the beginning of the good zone. */
  #extent(columns) {
    const { span, low, good } = this.#spec;
    const limits = good ? [] : this.#limits;
    let [least, most] = extremes(columns);
    if (least > most) [least, most] = low === null ? [-span / 2, span / 2] : [low, low + span];
    if (good) most = Math.max(most, 1.4 * good[0]); // the good zone is visible
    if (limits.length) most = Math.max(most, 1.15 * Math.min(...limits));
    if (limits.length && low === null) least = Math.min(least, -1.15 * Math.min(...limits));
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
    for (const name of compared) add(name, "error");
    this.#lane = compared.length ? 1 : null;
    const axis = { stroke: () => colours.ink, font: "11px system-ui, sans-serif", ticks: { show: false } };
    const grid = { stroke: () => colours.faint, width: 1 };
    const axes = [
      { ...axis, grid, size: 18, gap: 2, splits: () => this.#timeline.ticks().marks, values: () => this.#timeline.ticks().labels },
      { ...axis, grid, size: 46, gap: 4, space: 22, filter: (_, ticks) => ticks.map((t) => (t < this.#range[0] ? null : t)),
        values: (_, ticks) => ticks.map((tick) => (tick === null ? "" : minus(tick))) },
    ];
    if (this.#lane !== null) {
      axes.push({ ...axis, scale: "error", side: 1, grid, size: 46, gap: 4, splits: () => [-this.#lane, 0, this.#lane],
        filter: (_, ticks) => ticks, values: (_, ticks) => ticks.map((tick) => minus(Number(tick.toPrecision(3)))) });
    }
    return new uPlot({
      ...this.#size(),
      padding: [6, 6, 0, 0],
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false }, sync: { key: CURSORS } },
      legend: { show: false },
      scales: {
        x: { time: false, range: () => this.#timeline.window },
        y: { range: () => this.#mainRange() },
        error: { range: () => this.#laneRange() },
      },
      axes,
      series,
      bands,
      hooks: {
        drawClear: [(plot) => this.#drawZone(plot)],
        draw: [(plot) => this.#drawLimits(plot)],
        setSelect: [(plot) => this.#select(plot)],
      },
    }, [[], ...series.slice(1).map(() => [])], this.#frame);
  }

  /** The range of the main axis, with room for the lane below. */
  #mainRange() {
    const [least, most] = this.#range;
    return this.#lane === null ? [least, most] : [least - ((most - least) * LANE) / (1 - LANE), most];
  }

  /** The range of the lane's axis, with the lane at the bottom. */
  #laneRange() {
    const half = (this.#lane ?? 1) * 1.25;
    return [-half, half * (2 / LANE - 1)];
  }

  /** Draws the zone of good values. */
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

  /** Draws the limits as dashed lines. */
  #drawLimits(plot) {
    const { left, top, width, height } = plot.bbox;
    const both = !this.#spec.good && this.#spec.low === null;
    plot.ctx.save();
    plot.ctx.beginPath();
    for (const limit of this.#limits.flatMap((each) => (both ? [each, -each] : [each]))) {
      const y = plot.valToPos(limit, "y", true);
      if (y < top || y > top + height) continue;
      plot.ctx.moveTo(left, y);
      plot.ctx.lineTo(left + width, y);
    }
    plot.ctx.strokeStyle = this.#spec.good ? colours.good : colours.bad;
    plot.ctx.setLineDash([6, 4]);
    plot.ctx.stroke();
    plot.ctx.restore();
  }

  /** Zooms all plots to the selected range. */
  #select(plot) {
    const { left, width } = plot.select;
    if (width < SELECTED_PX) return;
    this.#timeline.zoom(plot.posToVal(left, "x"), plot.posToVal(left + width, "x"));
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
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
function roundLimit(columns, digits) {
  const [least, most] = extremes(columns);
  const largest = least > most ? 0 : Math.max(-least, most);
  const power = 10 ** Math.floor(Math.log10(Math.max(largest, 10 ** -digits)));
  return power * STEPS.find((step) => step * power >= largest);
}

/** The truth of a quantity at the times `x`; null where unknown. */
function truthOn(x, name, store, factor) {
  const { truth } = ESTIMATE[name];
  if (truth === "rig/truth") return store.truths.valuesAt(x, name, factor);
  const constant = store.get(truth)[name];
  return x.map(() => (constant === undefined ? null : constant * factor));
}
