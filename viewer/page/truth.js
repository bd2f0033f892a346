// The truth of the last seconds: the states of a full stream, tick by tick.
//
// A full stream has the states of its newest tick alone, so they are copied as each tick completes, not frame by frame.

import { frameOf } from "./frame.js";
import { rosterOf } from "./roster.js";

/** Bytes that are kept at most, and ticks. */
const BYTES_MAX = 64e6;
const TICKS_MAX = 300;

export class Truth {
  #client;
  #ticks = new Map();
  #layout;
  #bytes = 0;
  /** The newest tick. */
  newest = -1;

  /** Follows a client of a full stream. */
  constructor(client) {
    this.#client = client;
    client.record((channel) => {
      if (channel === "stateDown") this.read();
    });
  }

  /** Copies the states of the newest tick, if they were not copied before. */
  read() {
    const tick = this.#client.completeTick ?? this.#client.statistics.completeTick;
    if (tick <= this.newest) return;
    this.newest = tick;
    this.#client.show(tick);
    const { view } = this.#client;
    if (view.generation !== this.#layout?.generation) this.#layout = rosterOf(frameOf(view), this.#client);
    const positions = view.positions.slice();
    const rotations = view.rotations.slice();
    this.#ticks.set(tick, { tick, positions, rotations, resting: view.resting.slice(), layout: this.#layout });
    this.#bytes += 4 * (positions.length + rotations.length);
    this.#forget();
  }

  /** Maps keep the order in which entries were added: the first is the oldest. */
  #forget() {
    for (const [tick, { positions, rotations }] of this.#ticks) {
      if (this.#bytes <= BYTES_MAX && this.#ticks.size <= TICKS_MAX) return;
      this.#ticks.delete(tick);
      this.#bytes -= 4 * (positions.length + rotations.length);
    }
  }

  /** The states of a tick, and the bodies; undefined for a tick that was not seen. */
  at(tick) {
    return this.#ticks.get(tick);
  }
}
