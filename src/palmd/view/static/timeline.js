// Which piece of the run the plots show: the last seconds live, or a piece that is paused, scrubbed to or zoomed into.

const NARROWEST_S = 0.5;
const STEPS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 21600];
const TICKS = 5;

export class Timeline {
  #span = 10; // s; infinite for the whole run
  #end = NaN; // of the piece shown, while paused
  #newest = NaN;
  #oldest = NaN;
  #controls;

  /** `controls` by name: span, pause, scrub, cursor, narrower, wider, says; `moved(share)` hears where the cursor is put. */
  constructor(controls, moved) {
    this.#controls = controls;
    const { span, pause, scrub, cursor, narrower, wider } = controls;
    span.addEventListener("change", () => { this.#span = Number(span.value); });
    pause.addEventListener("click", () => this.pause(!this.paused));
    scrub.addEventListener("input", () => this.#scrub(Number(scrub.value)));
    cursor.addEventListener("input", () => moved(Number(cursor.value) / Number(cursor.max)));
    narrower.addEventListener("click", () => this.#scale(0.5));
    wider.addEventListener("click", () => this.#scale(2));
  }

  get paused() {
    return Number.isFinite(this.#end);
  }

  /** Stops at what is shown, or goes on live. */
  pause(on) {
    this.#end = on ? this.#newest : NaN;
    this.#controls.pause.setAttribute("aria-pressed", String(on));
  }

  /** What is kept of the run, from its oldest to its newest time (s). */
  reach(oldest, newest) {
    if (newest < this.#newest) this.pause(false); // another run
    [this.#oldest, this.#newest] = [oldest, newest];
  }

  /** The piece to show: [from, to] (s). */
  get window() {
    const to = this.paused ? this.#end : this.#newest;
    return [Number.isFinite(this.#span) ? to - this.#span : Math.min(this.#oldest, to - NARROWEST_S), to];
  }

  /** Whether the last ten seconds are shown as they come. */
  get live() {
    return !this.paused && this.#span === 10;
  }

  /** Shows from `from` to `to` (s), which somebody has chosen in a plot. */
  zoom(from, to) {
    this.#span = Math.max(to - from, NARROWEST_S);
    this.#end = Math.max(to, from + NARROWEST_S);
    this.#controls.pause.setAttribute("aria-pressed", "true");
    this.#showSpan();
  }

  /** Shows in the controls where the piece is; `cursor` (s) is where the cursor stands, NaN for nowhere. */
  tell(cursor) {
    const { scrub, pause, says } = this.#controls;
    const [from, to] = this.window;
    const range = Math.max(this.#newest - this.#oldest, NARROWEST_S);
    if (document.activeElement !== scrub || !this.paused) {
      scrub.value = String(Math.round(((to - this.#oldest) / range) * Number(scrub.max)) || 0);
    }
    const label = this.paused ? "Go on live" : "Pause";
    if (pause.textContent !== label) pause.textContent = label;
    const words = !Number.isFinite(to) ? "" : [
      this.paused ? `${relative(from - this.#newest)} to ${relative(to - this.#newest)}` : `last ${lasting(to - from)}, live`,
      Number.isFinite(cursor) ? `cursor ${relative(cursor - this.#newest)}` : "",
    ].filter(Boolean).join("; ");
    if (says.textContent !== words) says.textContent = words;
  }

  /** Times (s) at which an axis is marked, and their labels: so long before the newest. */
  ticks() {
    const [from, to] = this.window;
    const step = STEPS_S.find((each) => (to - from) / each <= TICKS) ?? STEPS_S.at(-1);
    const base = this.paused ? to : this.#newest;
    const marks = [];
    for (let back = step; base - back > from; back += step) marks.unshift(base - back);
    return { marks, labels: marks.map((mark) => relative(mark - this.#newest)) };
  }

  #scale(factor) {
    const [from, to] = this.window;
    const span = Math.max((to - from) * factor, NARROWEST_S);
    this.#span = span >= this.#newest - this.#oldest ? Infinity : span;
    this.#showSpan();
  }

  #scrub(place) {
    const range = this.#newest - this.#oldest;
    this.#end = this.#oldest + (range * place) / Number(this.#controls.scrub.max);
    this.#controls.pause.setAttribute("aria-pressed", "true");
    if (!Number.isFinite(this.#span)) this.#span = Math.max(range / 10, NARROWEST_S);
    this.#showSpan();
  }

  /** The choice shows the span where it is one of those offered, else none of them. */
  #showSpan() {
    const { span } = this.#controls;
    const offered = [...span.options].find(({ value }) => Number(value) === this.#span);
    span.value = offered ? offered.value : "";
  }
}

function lasting(seconds) {
  if (seconds < 100) return `${Number(seconds.toPrecision(2))} s`;
  return seconds < 6000 ? `${(seconds / 60).toFixed(1)} min` : `${(seconds / 3600).toFixed(1)} h`;
}

function relative(seconds) {
  return Math.abs(seconds) < 0.005 ? "now" : `−${lasting(Math.abs(seconds))}`;
}
