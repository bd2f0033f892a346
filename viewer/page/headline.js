// The two large numbers, the titles of the pictures, and the sentence that explains what would seem to contradict.

import { byteRate, metres, number, shortMetres } from "./text.js";

/** A ratio that is larger is not stated: next to nothing was received. */
const TIMES_MAX = 99_999;
/** Metres by which the page's arithmetic may be off. */
const ROUNDING = 1e-4;
/** Ticks by which the newest complete tick lies behind, from which a sentence says so. */
const BEHIND = 45;

export class Headline {
  #element;

  constructor(element) {
    this.#element = element;
  }

  /**
   * Shows figures: those of `sums`; `bodies` that can move; `tolerance` of what is shown; `moment`, the choice of what is shown;
   * `copy`, the name of the copy if it is not Rhumb's; `errorScale`; `waiting`, the ticks from the newest complete tick to the
   * newest known one.
   */
  show(facts) {
    const { sums, bodies, tolerance, copy } = facts;
    const { bytes, naive, worst, besideWorst } = sums;
    const times = naive / bytes;
    this.#write("times", Number.isFinite(times) && sums.seconds > 1 ? `${times > TIMES_MAX ? "> " : ""}${number(Math.min(times, TIMES_MAX), 0)}×` : "…");
    this.#write("times-words", `${byteRate(bytes || 0)}, where full states of ${bodies} bodies take ${byteRate(naive || 0)}`);
    this.#write("worst", worst === undefined ? "…" : metres(worst));
    const isBeyond = worst > tolerance + ROUNDING;
    this.#element("worst").classList.toggle("beyond", isBeyond);
    const within = tolerance > 0 ? `of the ${shortMetres(tolerance)} that ${isBeyond ? "complete ticks keep" : "you allow"}` : "";
    this.#write("worst-words", worst === undefined ? "nothing to compare with" : `${within}, in the last second`);
    this.#write("copy-title", `${copy ?? "Rhumb"}: off by ${worst === undefined ? "…" : metres(worst)}`);
    this.#write("beside-title", `Full states, same bytes: off by ${besideWorst === undefined ? "…" : metres(besideWorst)}`);
    this.#explain(isBeyond, facts);
  }

  #write(id, text) {
    const box = this.#element(id);
    if (box.textContent !== text) box.textContent = text;
  }

  #explain(isBeyond, facts) {
    const text = explanation(isBeyond, facts);
    this.#write("explanation-text", text ?? "");
    this.#element("explanation").hidden = text === undefined;
    this.#element("complete").hidden = facts.moment === "complete" || facts.moment === "recorded";
  }
}

/** The sentence without which the numbers would contradict each other; undefined if they do not. */
export function explanation(isBeyond, { moment, errorScale, waiting }) {
  if ((errorScale ?? 1) !== 1)
    return `The stream has fewer bytes than it needs: it states that errors may be ${number(errorScale, 1)} tolerances.`;
  if (isBeyond && moment === "predicted")
    return "More than the tolerance: this moment is predicted, ahead of what has arrived.";
  if (isBeyond && moment === "newest")
    return "More than the tolerance: a packet of this tick is missing, and its bodies have no stated bound.";
  if (isBeyond && moment === "recorded")
    return "More than the tolerance: the recorded client showed moments of which not everything had arrived.";
  if (isBeyond) return "More than the tolerance at a complete tick: this must not be. Please report it.";
  if (moment === "complete" && waiting > BEHIND)
    return `The pictures wait for what the link has lost: the newest complete tick is ${waiting} ticks old.`;
  return undefined;
}
