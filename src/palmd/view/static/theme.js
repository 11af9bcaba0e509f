// The page's colours, for what is drawn on canvases; they are defined in page.css alone.

const NAMES = ["ink", "faint", "line", "panel", "estimate-fill", "truth", "band", "single", "good-fill", "good"];

export const colours = {};

function read() {
  const style = getComputedStyle(document.documentElement);
  const value = (name) => style.getPropertyValue(`--${name}`).trim();
  for (const name of NAMES) colours[name] = value(name);
  for (const family of ["palm", "error"]) {
    for (let n = 0; n < 9; n++) if (value(family + n)) colours[family + n] = value(family + n);
  }
}

read();

/** The colour of what belongs to a palm. */
export function ofPalm(number) {
  return colours[`palm${number}`] ?? colours.single;
}

/** Calls back when the colours have changed with the system's light or dark. */
export function onColours(changed) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    read();
    changed();
  });
}
