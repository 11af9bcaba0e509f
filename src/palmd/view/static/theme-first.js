// Before anything is drawn: light or dark as chosen on this page, else as the system has it.
(() => {
  let chosen = null;
  try {
    chosen = localStorage.getItem("palmd-theme");
  } catch { /* no storage here */ }
  const dark = matchMedia("(prefers-color-scheme: dark)").matches;
  document.documentElement.dataset.theme = chosen ?? (dark ? "dark" : "light");
})();
