// Light or dark: as the system has it, until the button is used.

/** Follows the system and a button; `paint` is called at first and after each change. */
export function theme(button, paint) {
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");
  const isDark = () => (root.dataset.theme === undefined ? system.matches : root.dataset.theme === "dark");
  button.addEventListener("click", () => {
    root.dataset.theme = isDark() ? "light" : "dark";
    paint();
  });
  system.addEventListener("change", paint);
  // When the page is set up.
  requestAnimationFrame(paint);
}
