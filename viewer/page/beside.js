// The other picture, live: what a sender of full states shows of the same moment, at the bytes that Rhumb has used.

import { errorsOf } from "./comparison.js";
import { Sender } from "./sender.js";

export class Beside {
  #sender = new Sender();
  #truth;
  #tick;
  #bytes;
  #changed = [];
  #errorsBefore = new Float32Array(0);
  /** The truth of the tick that is shown. */
  actual;
  /** Error of each place, metres, and the greatest. */
  errors = new Float32Array(0);
  worst = 0;

  /**
   * Sends the ticks of a truth up to a time. `bytes`: all that the copy has received; what it had received before the first
   * call was for joining.
   */
  follow(truth, time, bytes) {
    if (truth !== this.#truth || bytes < this.#bytes) this.#begin(truth, bytes);
    const until = Math.min(time, truth.newest);
    this.#tick ??= until - 1;
    let fresh = bytes - this.#bytes;
    this.#changed = [];
    let actual;
    for (let tick = this.#tick + 1; tick <= until; tick++) {
      if (truth.at(tick) === undefined) continue;
      actual = truth.at(tick);
      for (const place of this.#sender.send(actual, fresh)) this.#changed.push(place);
      this.#bytes += fresh;
      fresh = 0;
    }
    this.#tick = Math.max(this.#tick, until);
    if (actual === undefined) return;
    this.actual = actual;
    const { count } = actual.layout;
    [this.errors, this.#errorsBefore] = [this.#errorsBefore, this.errors];
    if (this.errors.length !== count) this.errors = new Float32Array(count);
    this.worst = errorsOf(this.#sender, actual, actual.layout, this.errors);
  }

  #begin(truth, bytes) {
    this.#sender = new Sender();
    this.#truth = truth;
    this.#bytes = bytes;
    this.#tick = this.actual = undefined;
  }

  /** Places of which the error is another one than before. */
  get touched() {
    const before = this.#errorsBefore;
    return Array.from(this.actual.layout.movable).filter((place) => this.errors[place] !== before[place]);
  }

  /** The frame that its viewers see; undefined before there is one. */
  frame(tolerance) {
    if (this.actual === undefined) return undefined;
    const { layout, tick, resting } = this.actual;
    const { positions, rotations, ticks } = this.#sender;
    const tolerances = new Float32Array(layout.count).fill(tolerance ?? NaN);
    return { layout, time: tick, positions, rotations, resting, tolerances, updateTicks: ticks, changed: this.#changed };
  }
}
