// The time window of the plots: the last seconds live, or a paused, scrubbed or zoomed part of the run.

const NARROWEST_S = 0.5;
const STEPS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 21600];
const TICKS = 5;

export class Timeline {
  #span = 10; // s; infinite for the whole run
  #end = NaN; // end of the window while paused
  #newest = NaN;
  #oldest = NaN;
  #controls;

  /** `controls` by name: span, pause, scrub, cursor, narrower, wider, label; `onCursor(fraction)` is called when the cursor moves. */
  constructor(controls, onCursor) {
    this.#controls = controls;
    const { span, pause, scrub, cursor, narrower, wider } = controls;
    span.addEventListener("change", () => { this.#span = Number(span.value); });
    pause.addEventListener("click", () => this.pause(!this.paused));
    scrub.addEventListener("input", () => this.#scrub(Number(scrub.value)));
    cursor.addEventListener("input", () => onCursor(Number(cursor.value) / Number(cursor.max)));
    narrower.addEventListener("click", () => this.#scale(0.5));
    wider.addEventListener("click", () => this.#scale(2));
  }

  get paused() {
    return Number.isFinite(this.#end);
  }

  /** Freezes the window, or returns to live. */
  pause(on) {
    this.#end = on ? this.#newest : NaN;
    this.#controls.pause.setAttribute("aria-pressed", String(on));
  }

  /** Sets the stored time range of the run (s). */
  reach(oldest, newest) {
    if (newest < this.#newest) this.pause(false); // another run
    [this.#oldest, this.#newest] = [oldest, newest];
  }

  /** The window to show: [from, to] (s). */
  get window() {
    const to = this.paused ? this.#end : this.#newest;
    return [Number.isFinite(this.#span) ? to - this.#span : Math.min(this.#oldest, to - NARROWEST_S), to];
  }

  /** Whether the last ten seconds are shown live. */
  get live() {
    return !this.paused && this.#span === 10;
  }

  /** Shows from `from` to `to` (s), as selected in a plot. */
  zoom(from, to) {
    this.#span = Math.max(to - from, NARROWEST_S);
    this.#end = Math.max(to, from + NARROWEST_S);
    this.#controls.pause.setAttribute("aria-pressed", "true");
    this.#showSpan();
  }

  /** Updates the controls; `cursor`: time at the cursor (s), NaN without one. */
  update(cursor) {
    const { scrub, pause, label: output } = this.#controls;
    const [from, to] = this.window;
    const range = Math.max(this.#newest - this.#oldest, NARROWEST_S);
    if (document.activeElement !== scrub || !this.paused) {
      scrub.value = String(Math.round(((to - this.#oldest) / range) * Number(scrub.max)) || 0);
    }
    const label = this.paused ? "Live" : "Pause";
    if (pause.textContent !== label) pause.textContent = label;
    const words = !Number.isFinite(to) ? "" : [
      this.paused ? `${ageText(from - this.#newest)} to ${ageText(to - this.#newest)}` : `last ${durationText(to - from)}, live`,
      Number.isFinite(cursor) ? `cursor ${ageText(cursor - this.#newest)}` : "",
    ].filter(Boolean).join("; ");
    if (output.textContent !== words) output.textContent = words;
  }

  /** Tick times (s) of an axis, and their labels: ages relative to the newest time. */
  ticks() {
    const [from, to] = this.window;
    const step = STEPS_S.find((each) => (to - from) / each <= TICKS) ?? STEPS_S.at(-1);
    const base = this.paused ? to : this.#newest;
    const marks = [];
    for (let back = step; base - back > from; back += step) marks.unshift(base - back);
    return { marks, labels: marks.map((mark) => ageText(mark - this.#newest)) };
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

  /** Selects the current span in the list if it is offered there. */
  #showSpan() {
    const { span } = this.#controls;
    const offered = [...span.options].find(({ value }) => Number(value) === this.#span);
    span.value = offered ? offered.value : "";
  }
}

function durationText(seconds) {
  if (seconds < 100) return `${Number(seconds.toPrecision(2))} s`;
  return seconds < 6000 ? `${(seconds / 60).toFixed(1)} min` : `${(seconds / 3600).toFixed(1)} h`;
}

function ageText(seconds) {
  return Math.abs(seconds) < 0.005 ? "now" : `−${durationText(Math.abs(seconds))}`;
}
