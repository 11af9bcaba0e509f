// The page's colours for canvases, and the choice of light or dark theme; colours are defined only in page.css.

const NAMES = ["ink", "faint", "line", "panel", "estimate-fill", "truth", "band", "single", "good-fill", "good", "bad"];
const STORED = "palmd-theme";
const CHOICES = ["system", "light", "dark"];

export const colours = {};
const dark = matchMedia("(prefers-color-scheme: dark)");
const listeners = [];
let choice = localStorage.getItem(STORED) ?? "system";

function read() {
  const style = getComputedStyle(document.documentElement);
  const value = (name) => style.getPropertyValue(`--${name}`).trim();
  for (const name of NAMES) colours[name] = value(name);
  for (const family of ["palm", "error"]) {
    for (let n = 0; n < 9; n++) if (value(family + n)) colours[family + n] = value(family + n);
  }
}

function apply() {
  document.documentElement.dataset.theme = choice === "system" ? (dark.matches ? "dark" : "light") : choice;
  read();
  for (const changed of listeners) changed();
}

read();
dark.addEventListener("change", apply);

/** The colour of a palm and its quantities. */
export function ofPalm(number) {
  return colours[`palm${number}`] ?? colours.single;
}

/** Registers a callback for changes of the colours. */
export function onColours(changed) {
  listeners.push(changed);
}

/** Makes `button` cycle through the system's theme, light and dark. */
export function chooseTheme(button) {
  const show = () => button.setAttribute("aria-label", `Colours: ${choice}`);
  button.addEventListener("click", () => {
    choice = CHOICES[(CHOICES.indexOf(choice) + 1) % CHOICES.length];
    if (choice === "system") localStorage.removeItem(STORED);
    else localStorage.setItem(STORED, choice);
    button.title = `Colours: ${choice}`;
    show();
    apply();
  });
  button.title = `Colours: ${choice}`;
  show();
}
