// Colours of bodies: by error, rest, age or shape, and a flash where an update arrived.

/** Ticks over which a body's age fades, and seconds of a flash. */
const AGE_TICKS = 180;
const FLASH = 0.25;
/** Blue, sand and red: told apart by people who do not see red or green. Then violet, beyond the tolerance. */
const SHARES = [
  [0.17, 0.48, 0.71],
  [0.99, 0.85, 0.48],
  [0.84, 0.16, 0.11],
];
const BEYOND = [0.75, 0.1, 0.9];
const RESTING = [0.42, 0.47, 0.54];
const MOVING = [0.98, 0.58, 0.16];
const FRESH = [0.99, 0.91, 0.35];
const OLD = [0.15, 0.24, 0.45];
const UNKNOWN = [0.31, 0.62, 0.85];
const WHITE = [1, 1, 1];

function mix(a, b, share, out) {
  for (let part = 0; part < 3; part++) out[part] = a[part] + (b[part] - a[part]) * share;
}

const colour = [0, 0, 0];

/** The colour of an error as a share of the tolerance. */
function ofShare(share) {
  if (!Number.isFinite(share)) return UNKNOWN;
  if (share > 1) return BEYOND;
  if (share < 0.5) mix(SHARES[0], SHARES[1], 2 * share, colour);
  else mix(SHARES[1], SHARES[2], 2 * share - 1, colour);
  return colour;
}

/** A colour of its own for each number. */
function ofNumber(number) {
  for (let part = 0; part < 3; part++) {
    colour[part] = 0.6 + 0.35 * Math.cos(2 * Math.PI * (number * 0.618034 + part / 3));
  }
  return colour;
}

export class Colours {
  mode = "error";
  flashes = true;
  #updates = new Float64Array(0);
  #flashed = new Float64Array(0);
  #generation;
  /** The body that is marked; its place. */
  marked = -1;

  /** Colours a frame's bodies; `errors` are undefined where there is no truth. `now` in seconds. */
  apply(bodies, frame, errors, now) {
    const { updateTicks, tolerances, resting, count } = frame;
    const shapes = frame.shapes ?? frame.shapeNumbers;
    if (this.#generation !== frame.generation || this.#updates.length !== count) {
      this.#generation = frame.generation;
      this.#updates = Float64Array.from(updateTicks ?? new Float64Array(count));
      this.#flashed = new Float64Array(count).fill(-Infinity);
    }
    for (const place of bodies.movable) {
      const chosen = this.#chosen(place, frame, errors, tolerances, resting, shapes);
      if (updateTicks !== undefined && updateTicks[place] !== this.#updates[place]) {
        this.#updates[place] = updateTicks[place];
        this.#flashed[place] = now;
      }
      const flash = this.flashes ? 1 - (now - this.#flashed[place]) / FLASH : 0;
      if (place === this.marked || flash > 0) mix(chosen, WHITE, place === this.marked ? 0.85 : 0.5 * flash, colour);
      else if (chosen !== colour) [colour[0], colour[1], colour[2]] = chosen;
      bodies.colour(place, colour[0], colour[1], colour[2]);
    }
  }

  #chosen(place, frame, errors, tolerances, resting, shapes) {
    switch (this.mode) {
      case "error":
        return errors === undefined ? UNKNOWN : ofShare(errors[place] / tolerances[place]);
      case "rest":
        return resting[place] === 1 ? RESTING : MOVING;
      case "age":
        if (frame.updateTicks === undefined) return UNKNOWN;
        mix(FRESH, OLD, Math.min(1, Math.max(0, frame.time - frame.updateTicks[place]) / AGE_TICKS), colour);
        return colour;
      default:
        return ofNumber(shapes[place]);
    }
  }
}
