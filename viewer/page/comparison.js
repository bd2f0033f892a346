// How far a copy is from the truth at one tick: the error of the surface, as RECKONING 2 defines it.

import { placesIn } from "./frame.js";

/**
 * Metres by which the arithmetic of this page may be off: poses are 32-bit numbers, which are 8 micrometres apart at a
 * distance of 100 m.
 */
export const ROUNDING = 1e-4;

export class Comparison {
  #places = new Int32Array(0);
  #generations = [undefined, undefined];
  /** Error of each place at the last compared tick, metres. */
  errors = new Float32Array(0);
  /** Of the last compared tick. */
  worst = 0;
  worstShare = 0;
  /** Since the page was loaded: ticks at which both copies were complete, body-ticks then, and those beyond the tolerance. */
  ticks = 0;
  bodyTicks = 0;
  beyondTolerance = 0;
  /** Body-ticks whose bound was known, and those beyond it. */
  boundedBodyTicks = 0;
  beyondBound = 0;
  /** Greatest error as a share of the tolerance, at ticks at which both copies were complete. */
  greatestShare = 0;
  #lastTick = -1;

  /** Compares a copy with the truth; `isComplete`: nothing that concerns this tick is missing from either. */
  compare(copy, truth, { movable, radii }, isComplete) {
    if (this.#generations[0] !== copy.generation || this.#generations[1] !== truth.generation) {
      this.#generations = [copy.generation, truth.generation];
      this.#places = placesIn(copy, truth);
      this.errors = new Float32Array(copy.count);
    }
    const isNew = copy.time !== this.#lastTick;
    this.#lastTick = copy.time;
    this.worst = 0;
    this.worstShare = 0;
    let beyondTolerance = 0;
    let beyondBound = 0;
    let bounded = 0;
    for (const place of movable) {
      const other = this.#places[place];
      if (other < 0) continue;
      const error = surfaceError(copy, place, truth, other, radii[place]);
      this.errors[place] = error;
      const share = error / copy.tolerances[place];
      if (error > this.worst) this.worst = error;
      if (share > this.worstShare) this.worstShare = share;
      if (error > copy.tolerances[place] + ROUNDING) beyondTolerance++;
      const bound = copy.errorBounds[place];
      if (Number.isFinite(bound)) {
        bounded++;
        if (error > bound + ROUNDING) beyondBound++;
      }
    }
    if (!isNew) return;
    this.boundedBodyTicks += bounded;
    this.beyondBound += beyondBound;
    if (isComplete) {
      this.ticks++;
      this.bodyTicks += movable.length;
      this.beyondTolerance += beyondTolerance;
      this.greatestShare = Math.max(this.greatestShare, this.worstShare);
    }
  }
}

/** The shift of the centre of mass, and the chord of the turn at the bounding radius, metres. */
export function surfaceError(a, i, b, j, radius) {
  const p = a.positions, q = b.positions, r = a.rotations, s = b.rotations;
  const shift = Math.hypot(p[3 * i] - q[3 * j], p[3 * i + 1] - q[3 * j + 1], p[3 * i + 2] - q[3 * j + 2]);
  let same = 0, opposite = 0;
  for (let part = 0; part < 4; part++) {
    const one = r[4 * i + part], other = s[4 * j + part];
    same += (one - other) ** 2;
    opposite += (one + other) ** 2;
  }
  // Half the distance of two unit quaternions is the sine of a quarter of the turn.
  const quarter = Math.min(1, Math.sqrt(Math.min(same, opposite)) / 2);
  return shift + 2 * radius * 2 * quarter * Math.sqrt(1 - quarter * quarter);
}
