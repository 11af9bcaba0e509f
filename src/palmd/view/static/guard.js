// Buttons that need a second press, for actions that move the arm or cannot be undone.

const CONFIRM_MS = 3000;
const DOUBLE_CLICK_MS = 350; // two presses within this time count as one

/** Calls `act` when `button` is pressed twice within 3 s; meanwhile its label asks for the second press. */
export function onSecondPress(button, act) {
  const label = button.textContent;
  let since = -Infinity;
  let timer = 0;
  const forget = () => {
    clearTimeout(timer);
    since = -Infinity;
    button.textContent = label;
    button.classList.remove("confirming");
  };
  button.addEventListener("click", () => {
    const now = performance.now();
    if (now - since < DOUBLE_CLICK_MS) return;
    if (now - since < CONFIRM_MS) {
      forget();
      act();
      return;
    }
    since = now;
    button.textContent = "Press again";
    button.classList.add("confirming");
    timer = setTimeout(forget, CONFIRM_MS);
  });
}
