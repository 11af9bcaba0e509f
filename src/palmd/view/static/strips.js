// Strips: the last seconds of a quantity or two, with ± one sigma as a band and the rig's truth dashed.

import { ESTIMATE, STRIPS } from "./quantities.js";
import { number } from "./readouts.js";
import { SD, WINDOW_S } from "./store.js";
import { colours } from "./theme.js";

const STRIDE = 2; // 50 samples a second are more than there are pixels

export class Strips {
  #strips;
  #turn = 0;

  constructor(container) {
    this.#strips = STRIPS.map((strip) => new Strip(container, strip));
    new ResizeObserver(() => this.#strips.forEach((strip) => strip.resize())).observe(container);
  }

  /** Draws the next strip or two of the round: all at once would take a whole frame. */
  draw(store, count) {
    for (let i = 0; i < count; i++) {
      this.#strips[this.#turn].draw(store);
      this.#turn = (this.#turn + 1) % this.#strips.length;
    }
  }

  get length() {
    return this.#strips.length;
  }

  /** The numbers above the strips. */
  tell(store) {
    for (const strip of this.#strips) strip.tell(store.get("palm/estimate"));
  }

  recolour() {
    for (const strip of this.#strips) strip.recolour();
  }
}

class Strip {
  #spec;
  #figure;
  #values = [];
  #frame; // what the plot fills
  #plot;
  #range = [0, 1];
  #newest = 0;

  constructor(container, spec) {
    this.#spec = spec;
    this.#figure = document.createElement("figure");
    this.#figure.className = "strip";
    this.#figure.setAttribute("aria-label", spec.title);
    const caption = document.createElement("figcaption");
    caption.title = spec.title;
    for (const { symbol, meaning, colour } of spec.names.map((name) => ESTIMATE[name])) {
      const name = Object.assign(document.createElement("span"), { className: `name ${colour}`, textContent: symbol,
        title: meaning });
      const value = Object.assign(document.createElement("span"), { className: "value" });
      caption.append(name, value);
      this.#values.push(value);
    }
    caption.append(Object.assign(document.createElement("span"), { className: "unit", textContent: spec.unit }));
    this.#frame = Object.assign(document.createElement("div"), { className: "plot" });
    this.#figure.append(caption, this.#frame);
    container.append(this.#figure);
    this.#plot = this.#build();
  }

  /** The last value of each curve with its sigma. */
  tell(estimate) {
    const { names, factor, digits } = this.#spec;
    names.forEach((name, i) => {
      const [value, sd] = [estimate[name] * factor, estimate.sd?.[name] * factor];
      const shown = estimate.valid || !ESTIMATE[name].uncertain;
      this.#values[i].textContent = !shown || !Number.isFinite(value) ? "–"
        : number(value, digits) + (Number.isFinite(sd) ? ` ± ${number(sd, sd < 0.1 ? 3 : digits)}` : "");
    });
  }

  draw(store) {
    const { names, factor } = this.#spec;
    const { estimates } = store;
    if (Number.isNaN(estimates.newest)) return;
    this.#newest = estimates.newest;
    const since = estimates.newest - WINDOW_S;
    const x = estimates.times(since, STRIDE);
    const columns = [x];
    for (const name of names) {
      const value = estimates.values(name, since, STRIDE, factor);
      columns.push(value);
      if (!ESTIMATE[name].uncertain) continue;
      const sd = estimates.values(SD + name, since, STRIDE, factor);
      columns.push(value.map((v, i) => (v === null || sd[i] === null ? null : v + sd[i])));
      columns.push(value.map((v, i) => (v === null || sd[i] === null ? null : v - sd[i])));
    }
    for (const name of names) if (ESTIMATE[name].truth) columns.push(truthOn(x, name, store, factor));
    this.#range = this.#extent(columns);
    this.#plot.setData(columns);
  }

  resize() {
    this.#plot.setSize(this.#size());
  }

  recolour() {
    this.#plot.destroy();
    this.#plot = this.#build();
  }

  /** The axis: all there is to see with some air, no less than the least span. */
  #extent([, ...columns]) {
    const { span, low } = this.#spec;
    let [least, most] = [Infinity, -Infinity];
    for (const column of columns) {
      for (const value of column) {
        if (value === null) continue;
        if (value < least) least = value;
        if (value > most) most = value;
      }
    }
    if (least > most) return [low ?? -span, span];
    const air = Math.max((most - least) * 0.08, (span - (most - least)) / 2);
    return [low ?? least - air, most + air];
  }

  #build() {
    const curves = this.#spec.names.map((name) => ESTIMATE[name]);
    const points = { show: false };
    const series = [{}];
    const bands = [];
    for (const { symbol, uncertain, colour } of curves) {
      series.push({ label: symbol, stroke: () => colours[colour], width: 1.5, points });
      if (!uncertain) continue;
      bands.push({ series: [series.length, series.length + 1], fill: () => `${colours[colour]}40` });
      series.push({ points }, { points });
    }
    for (const { symbol, truth } of curves) {
      if (!truth) continue;
      series.push({ label: `${symbol} true`, stroke: () => colours.truth, width: 1.2, dash: [5, 4], points });
    }
    const axis = { stroke: () => colours.ink, font: "11px system-ui, sans-serif", ticks: { show: false } };
    const grid = { stroke: () => colours.faint, width: 1 };
    return new uPlot({
      ...this.#size(),
      padding: [6, 6, 0, 0],
      cursor: { show: false },
      legend: { show: false },
      scales: {
        x: { time: false, range: () => [this.#newest - WINDOW_S, this.#newest] },
        y: { range: () => this.#range },
      },
      axes: [
        { ...axis, grid, size: 18, gap: 2, splits: () => [-8, -6, -4, -2].map((s) => this.#newest + s),
          values: () => ["−8", "−6", "−4", "−2 s"] },
        { ...axis, grid, size: 44, gap: 4, space: 22, values: (_, ticks) => ticks.map(minus) },
      ],
      series,
      bands,
    }, [[], ...series.slice(1).map(() => [])], this.#frame);
  }

  #size() {
    return { width: this.#frame.clientWidth, height: this.#frame.clientHeight };
  }
}

function minus(tick) {
  return String(tick).replace("-", "−");
}

/** The truth of a quantity at the times `x`; no values where there is no truth. */
function truthOn(x, name, store, factor) {
  const { truth } = ESTIMATE[name];
  if (truth === "rig/truth") return store.truths.valuesAt(x, name, factor);
  const constant = store.get(truth)[name];
  return x.map(() => (constant === undefined ? null : constant * factor));
}
