// The page's colours, for what is drawn on canvases; they are defined in page.css alone.

const NAMES = ["ink", "faint", "line", "panel", "palm1", "palm2", "estimate", "estimate-fill", "truth", "band", "single"];

export const colours = {};

function read() {
  const style = getComputedStyle(document.documentElement);
  for (const name of NAMES) colours[name] = style.getPropertyValue(`--${name}`).trim();
}

read();

/** Calls back when the colours have changed with the system's light or dark. */
export function onColours(changed) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    read();
    changed();
  });
}
