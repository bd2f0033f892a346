// The page's buttons, sliders and choices, and what of them stands in the address.

import { writeAddress } from "./address.js";
import { metres } from "./text.js";

/** Milliseconds of calm before another tolerance is asked for. */
const CALM = 200;
/** The tolerance of a place of the slider: from 1 mm to 1 m, even in its logarithm. */
const toleranceAt = (place) => Number((10 ** (-3 + (3 * place) / 100)).toPrecision(2));

/** The choice of the tolerance, and its slider and buttons. */
export class Tolerance {
  #element;
  #set;
  #calm;

  /** `set` is called with metres that were chosen. */
  constructor(element, set) {
    this.#element = element;
    this.#set = set;
    element("tolerance").addEventListener("input", ({ target }) => {
      const length = toleranceAt(Number(target.value));
      element("tolerance-shown").textContent = metres(length);
      clearTimeout(this.#calm);
      this.#calm = setTimeout(() => this.choose(length), CALM);
    });
    for (const button of this.#buttons) {
      button.addEventListener("click", () => this.choose(Number(button.dataset.tolerance)));
    }
  }

  get #buttons() {
    return document.querySelectorAll("[data-tolerance]");
  }

  choose(length) {
    this.show(length);
    writeAddress({ tolerance: length });
    this.#set(length);
  }

  /** Shows a tolerance, metres. */
  show(length) {
    this.#element("tolerance").value = Math.round(((Math.log10(length) + 3) * 100) / 3);
    this.#element("tolerance-shown").textContent = metres(length);
    for (const button of this.#buttons) button.setAttribute("aria-pressed", Number(button.dataset.tolerance) === length);
  }
}

/** Offers names in a choice, the present one chosen; hides a choice of one, if it is to be. */
export function offer(select, names, present) {
  if ([...select.options].map(({ value }) => value).join() !== names.join())
    select.replaceChildren(...names.map((name) => new Option(name, name)));
  if (present !== undefined) select.value = present;
}

/** The value that is chosen, or whether a box is checked. */
const valueOf = (box) => (box.type === "checkbox" ? box.checked : box.value);

/** Calls an action with each value that is chosen, or with whether a box is checked. */
export function onChoice(box, act) {
  box.addEventListener("change", () => act(valueOf(box)));
}

/** As `onChoice`, and at once with the present value: a hand may have chosen it before the script ran. */
export function onValue(box, act) {
  onChoice(box, act);
  act(valueOf(box));
}

/** Chooses an option as a hand does. */
export function choose(box, value) {
  box.value = value;
  box.dispatchEvent(new Event("change"));
}
