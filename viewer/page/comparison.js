// How far what was shown was from the truth of the same tick: the error of the surface, as RECKONING 2 defines it.
//
// A tick may be shown before its truth has arrived. So what was shown is kept until then.

import { AWAY } from "./roster.js";

/**
 * Metres by which the arithmetic of this page may be off: poses are 32-bit numbers, which are 8 micrometres apart at a
 * distance of 100 m.
 */
export const ROUNDING = 1e-4;
/** Frames that wait for their truth. */
const WAITING_MAX = 120;

export class Comparison {
  #waiting = [];
  /** Error of each place at the last compared tick, metres, and the generation of these places. */
  errors = new Float32Array(0);
  /** Of the last compared tick: the bodies, their poses as shown and as they were, the greatest error and the tolerance. */
  layout;
  shown;
  actual;
  tick = -1;
  worst = 0;
  tolerance;
  /** True if that tick was complete when it was shown. */
  isComplete = false;
  /** Ticks compared since the page was loaded that were complete when they were shown. */
  ticks = 0;
  /** The bodies of those ticks whose bound was known, and how many of them were beyond their tolerance. */
  bodyTicks = 0;
  beyondTolerance = 0;
  /** Greatest error there as a share of the tolerance. */
  greatestShare = 0;
  /** Bodies of all compared ticks whose bound was known when they were shown, and how many were beyond it. */
  boundedBodyTicks = 0;
  beyondBound = 0;
  /** Bodies of all compared ticks, and how many of them were beyond their tolerance. */
  allBodyTicks = 0;
  allBeyondTolerance = 0;
  /** Ticks that were shown and of which no truth has come. */
  unjudged = 0;

  /** Notes what is shown: `isComplete` if nothing that concerns this tick is missing. Whole ticks only. */
  show(frame, layout, isComplete) {
    const { time: tick, positions, rotations, tolerances, errorBounds } = frame;
    if (tick <= (this.#waiting.at(-1)?.tick ?? this.tick)) return;
    this.#waiting.push({
      tick,
      layout,
      isComplete,
      positions: positions.slice(),
      rotations: rotations.slice(),
      tolerances: tolerances.slice(),
      errorBounds: errorBounds.slice(),
    });
    if (this.#waiting.length > WAITING_MAX) {
      this.#waiting.shift();
      this.unjudged++;
    }
  }

  /** Compares what was shown with the truth that has arrived. */
  settle(truth) {
    while (this.#waiting.length > 0 && this.#waiting[0].tick <= truth.newest) {
      const shown = this.#waiting.shift();
      const actual = truth.at(shown.tick);
      if (actual !== undefined) this.#compare(shown, actual);
      else this.unjudged++;
    }
  }

  #compare(shown, actual) {
    const { tick, layout, isComplete, tolerances, errorBounds } = shown;
    const { ids, radii } = layout;
    Object.assign(this, { tick, layout, isComplete, shown, actual, worst: 0, tolerance: undefined });
    if (this.errors.length !== ids.length) this.errors = new Float32Array(ids.length);
    for (const place of layout.movable) {
      const other = actual.layout.places.get(ids[place]);
      if (other === undefined) continue;
      const error = surfaceError(shown, place, actual, other, radii[place]);
      const tolerance = tolerances[place];
      this.errors[place] = error;
      this.worst = Math.max(this.worst, error);
      this.tolerance = Math.max(this.tolerance ?? 0, tolerance);
      this.allBodyTicks++;
      if (error > tolerance + ROUNDING) this.allBeyondTolerance++;
      // Of a tick that is complete, but not the newest one, a body may have lost its known track.
      if (!Number.isFinite(errorBounds[place])) continue;
      this.boundedBodyTicks++;
      if (error > errorBounds[place] + ROUNDING) this.beyondBound++;
      if (!isComplete) continue;
      this.bodyTicks++;
      this.greatestShare = Math.max(this.greatestShare, error / tolerance);
      if (error > tolerance + ROUNDING) this.beyondTolerance++;
    }
    if (isComplete) this.ticks++;
  }

  /** The scene, or its connection, is another one. */
  restart() {
    this.#waiting = [];
    this.tick = -1;
    this.layout = this.shown = this.actual = undefined;
  }
}

/**
 * Writes the error of each body that can move into `errors`, NaN for one that is not there; returns the greatest. Both have the
 * places of one layout.
 */
export function errorsOf(shown, actual, { movable, radii }, errors) {
  let worst = 0;
  for (const place of movable) {
    errors[place] = NaN;
    if (shown.positions[3 * place] === AWAY || actual.positions[3 * place] === AWAY) continue;
    const error = surfaceError(shown, place, actual, place, radii[place]);
    errors[place] = error;
    if (error > worst) worst = error;
  }
  return worst;
}

/** The shift of the centre of mass, and the chord of the turn at the bounding radius, metres. */
export function surfaceError(a, i, b, j, radius) {
  const p = a.positions,
    q = b.positions,
    r = a.rotations,
    s = b.rotations;
  const shift = Math.hypot(p[3 * i] - q[3 * j], p[3 * i + 1] - q[3 * j + 1], p[3 * i + 2] - q[3 * j + 2]);
  let same = 0,
    opposite = 0;
  for (let part = 0; part < 4; part++) {
    const one = r[4 * i + part],
      other = s[4 * j + part];
    same += (one - other) ** 2;
    opposite += (one + other) ** 2;
  }
  // Half the distance of two unit quaternions is the sine of a quarter of the turn.
  const quarter = Math.min(1, Math.sqrt(Math.min(same, opposite)) / 2);
  return shift + 2 * radius * 2 * quarter * Math.sqrt(1 - quarter * quarter);
}
