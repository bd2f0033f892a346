// Colours of bodies: by error, rest, age or shape, with the words that explain them.

import { Color, SRGBColorSpace } from "three";
import { shortMetres } from "./text.js";

/** Ticks over which a body's age fades. */
const AGE_TICKS = 180;
/** Blue, sand and red: told apart by people who do not see red or green. Then violet, beyond the tolerance. */
const NONE = "#2b7bb6";
const HALF = "#f2cf6a";
const WHOLE = "#d7301f";
const BEYOND = "#8e24c9";
const RESTING = "#6b7889";
const MOVING = "#f39422";
const FRESH = "#f7e05a";
const OLD = "#2a4076";
const UNKNOWN = "#4f9fd8";
const MARKED = "#ffffff";

/** A colour of the style sheet as three.js mixes and draws it. */
function linear(name) {
  return new Color().setStyle(name, SRGBColorSpace).toArray();
}

const [none, half, whole, beyond] = [NONE, HALF, WHOLE, BEYOND].map(linear);
const [resting, moving, fresh, old, unknown, marked] = [RESTING, MOVING, FRESH, OLD, UNKNOWN, MARKED].map(linear);

function mix(a, b, share, out) {
  for (let part = 0; part < 3; part++) out[part] = a[part] + (b[part] - a[part]) * share;
  return out;
}

const colour = [0, 0, 0];

/** The colour of an error as a share of the tolerance. */
function ofShare(share) {
  if (!Number.isFinite(share)) return unknown;
  if (share > 1) return beyond;
  return share < 0.5 ? mix(none, half, 2 * share, colour) : mix(half, whole, 2 * share - 1, colour);
}

/** A colour of its own for each number. */
function ofNumber(number) {
  for (let part = 0; part < 3; part++) {
    colour[part] = 0.4 + 0.35 * Math.cos(2 * Math.PI * (number * 0.618034 + part / 3));
  }
  return colour;
}

export class Colours {
  mode = "error";
  /** Of each set of bodies, what its colours follow from, if the next frame cannot change them. */
  #painted = new WeakMap();

  /** Colours a frame's bodies; `errors` are undefined where there is no truth. `picked`: the place of the picked body. */
  apply(bodies, frame, errors, picked) {
    const painted = this.#stays(frame, errors) ? { mode: this.mode, layout: frame.layout, picked } : undefined;
    const before = this.#painted.get(bodies);
    this.#painted.set(bodies, painted);
    if (painted && before && Object.keys(painted).every((name) => painted[name] === before[name])) return;
    for (const place of bodies.movable) {
      const chosen = this.#chosen(place, frame, errors);
      bodies.colour(place, chosen[0], chosen[1], chosen[2]);
    }
    if (picked >= 0) bodies.colour(picked, ...mix(this.#chosen(picked, frame, errors), marked, 0.7, colour));
  }

  /** True if the next frame of these bodies has the same colours. */
  #stays({ updateTicks }, errors) {
    if (this.mode === "error") return errors === undefined;
    return this.mode === "age" ? updateTicks === undefined : this.mode === "shape";
  }

  #chosen(place, { layout, time, updateTicks, tolerances, resting: rests }, errors) {
    switch (this.mode) {
      case "error":
        return errors === undefined ? unknown : ofShare(errors[place] / tolerances[place]);
      case "rest":
        return rests[place] === 1 ? resting : moving;
      case "age":
        if (updateTicks === undefined) return unknown;
        return mix(fresh, old, Math.min(1, Math.max(0, time - updateTicks[place]) / AGE_TICKS), colour);
      default:
        return ofNumber(layout.shapeNumbers[place]);
    }
  }

  /**
   * The meaning of the colours: `from` and `to` with the steps between them, and the patches beside that bar. `hasErrors`: there is
   * a truth to compare with.
   */
  legend(tolerance, hasErrors) {
    switch (this.mode) {
      case "error":
        if (!hasErrors) return { title: "No truth to compare with", patches: [[UNKNOWN, "error unknown"]] };
        return {
          title: "Error",
          bar: [NONE, HALF, WHOLE],
          from: "none",
          to: tolerance > 0 ? shortMetres(tolerance) : "the tolerance",
          patches: [[BEYOND, "beyond the tolerance"]],
        };
      case "rest":
        return { title: "Motion", patches: [[MOVING, "moves"], [RESTING, "rests"]] };
      case "age":
        return { title: "Last update", bar: [FRESH, OLD], from: "now", to: `${AGE_TICKS} ticks ago, or more`, patches: [] };
      default:
        return { title: "A colour for each shape", patches: [] };
    }
  }
}

/** Shows a legend in an element: a bar with words at its ends, and patches with theirs. */
export function showLegend(box, { title, bar, from, to, patches }) {
  const part = (name, text, background) => {
    const made = document.createElement(name);
    made.textContent = text;
    if (background !== undefined) made.style.background = background;
    return made;
  };
  const parts = [part("b", title)];
  if (bar !== undefined) {
    // As the bodies' colours are mixed.
    parts.push(part("span", from), part("i", "", `linear-gradient(in srgb-linear to right, ${bar.join(", ")})`), part("span", to));
    parts.at(-2).className = "bar";
  }
  for (const [background, text] of patches) {
    const pair = part("span", "");
    pair.append(part("i", "", background), text);
    parts.push(pair);
  }
  box.replaceChildren(...parts);
}
