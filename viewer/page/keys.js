// Keys and pointers.

/** Pixels by which a pointer may move between its press and its release and still click. */
const STILL = 4;

/** Controls that need keys for themselves, by their types: all other keys are the page's even there. */
const OWN_KEYS = {
  range: /^(Arrow|Page|Home|End)/,
  "select-one": /^(Arrow|Page|Home|End|Key|Digit|Space|Enter|Escape)/,
  checkbox: /^Space/,
  button: /^(Space|Enter)/,
  submit: /^(Space|Enter)/,
  file: /^(Space|Enter)/,
};

function isOwn({ target, code }) {
  if (target.localName === "summary") return /^(Space|Enter)/.test(code);
  return OWN_KEYS[target.type]?.test(code) ?? false;
}

/**
 * Makes keys act, wherever the focus is. `press` and `release` get the codes of keys that are held, and `press` returns true if
 * it takes one.
 */
export function keys(canvas, actions, { press, release, releaseAll }) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || isOwn(event)) return;
    const action = actions[event.code];
    if (!press(event.code)) {
      if (action === undefined) return;
      action();
    }
    event.preventDefault();
  });
  document.addEventListener("keyup", ({ code }) => release(code));
  addEventListener("blur", releaseAll);
  // A control that was used by a pointer gives the keys back to the scene; one that was used by keys keeps them.
  let isPointed = false;
  addEventListener("pointerdown", () => (isPointed = true), { capture: true });
  addEventListener("keydown", () => (isPointed = false), { capture: true });
  const giveBack = ({ target }) => {
    if (isPointed && target.matches?.("input, select, button, summary")) canvas.focus({ preventScroll: true });
  };
  document.addEventListener("change", giveBack);
  document.addEventListener("click", (event) => {
    if (!event.target.matches?.("select, input[type=file]")) giveBack(event);
  });
}

/** Makes the pointer carry bodies with shift (`carry`, which returns true if it takes one), and pick them by a click. */
export function pointers(canvas, { carry, move, drop, pick }) {
  let pressed;
  canvas.addEventListener(
    "pointerdown",
    (event) => {
      canvas.focus({ preventScroll: true });
      pressed = [event.clientX, event.clientY];
      if (!event.shiftKey || !carry(event)) return;
      event.stopImmediatePropagation();
      canvas.setPointerCapture(event.pointerId);
    },
    { capture: true },
  );
  canvas.addEventListener("pointermove", move);
  canvas.addEventListener("pointerup", (event) => {
    if (drop()) return;
    const moved = pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]);
    if (moved !== undefined && moved <= STILL) pick(event);
  });
}
