// Sets the light or dark theme before anything is drawn: as chosen on this page, else as in the system.
(() => {
  let chosen = null;
  try {
    chosen = localStorage.getItem("palmd-theme");
  } catch { /* no storage available */ }
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = chosen ?? (dark ? "dark" : "light");
})();
