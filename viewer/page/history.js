// The last minute, to look at again.
//
// A whole frame every two seconds, and in between the bodies that changed. Beyond a bound of memory, less than a minute.

/** Seconds that are kept, frames a second, and seconds between whole frames. */
const KEPT = 60;
const RATE = 30;
const WHOLE = 2;
const BYTES_MAX = 80e6;
/** Bytes of one body of a frame. */
const BODY_BYTES = 4 + 12 + 16 + 1 + 4;

export class History {
  #frames = [];
  #bytes = 0;
  #layout;
  #whole = -Infinity;
  #last = -Infinity;
  /** Places that changed since the last frame that was kept, each once; and for each place, 1 if it is one of them. */
  #pending = [];
  #isPending = new Uint8Array(0);

  /** Number of frames. */
  get length() {
    return this.#frames.length;
  }

  /** When a frame was added, seconds. */
  at(index) {
    return this.#frames[index]?.at;
  }

  /** The frame that was shown at a time; the oldest if none is as old. */
  indexAt(at) {
    const index = this.#frames.findLastIndex((frame) => frame.at <= at);
    return Math.max(0, index);
  }

  /** Adds a live frame. `errors`: of the comparison, or undefined. `now` in seconds. */
  add(frame, errors, now) {
    const isNew = frame.layout !== this.#layout;
    if (isNew) this.#begin(frame.layout);
    this.#note(frame.changed);
    if (!isNew && now - this.#last < 1 / RATE - 0.004) return;
    this.#last = now;
    const isWhole = isNew || now - this.#whole >= WHOLE;
    if (isWhole) this.#whole = now;
    const places = Uint32Array.from(isWhole ? frame.layout.ids.keys() : this.#pending);
    for (const place of this.#pending) this.#isPending[place] = 0;
    this.#pending.length = 0;
    const kept = { at: now, time: frame.time, layout: frame.layout, isWhole, places };
    kept.positions = gather(frame.positions, places, 3);
    kept.rotations = gather(frame.rotations, places, 4);
    kept.errors = errors && gather(errors, places, 1);
    kept.resting = gather(frame.resting, places, 1);
    kept.tolerance = frame.tolerances?.at(-1);
    this.#frames.push(kept);
    this.#bytes += places.length * BODY_BYTES;
    this.#forget(now);
  }

  #begin(layout) {
    this.#layout = layout;
    this.#pending.length = 0;
    this.#isPending = new Uint8Array(layout.count);
  }

  #note(changed) {
    for (const place of changed) {
      if (this.#isPending[place] === 1) continue;
      this.#isPending[place] = 1;
      this.#pending.push(place);
    }
  }

  /** Drops what is too old or too much, up to the next whole frame. */
  #forget(now) {
    while (this.#frames.length > 1 && (now - this.#frames[0].at > KEPT || this.#bytes > BYTES_MAX)) {
      const next = this.#frames.findIndex((frame, index) => index > 0 && frame.isWhole);
      if (next < 0) return;
      for (const frame of this.#frames.splice(0, next)) this.#bytes -= frame.places.length * BODY_BYTES;
    }
  }

  /** A frame as it was shown; its arrays are the caller's. */
  frame(index) {
    let whole = index;
    while (!this.#frames[whole].isWhole) whole--;
    const { layout, time } = this.#frames[index];
    const { count } = layout;
    const frame = {
      layout,
      time,
      positions: new Float32Array(3 * count),
      rotations: new Float32Array(4 * count),
      resting: new Uint8Array(count),
      tolerances: new Float32Array(count).fill(this.#frames[index].tolerance ?? 0),
      errors: new Float32Array(count).fill(NaN),
    };
    for (let at = whole; at <= index; at++) {
      const { places, positions, rotations, resting, errors } = this.#frames[at];
      scatter(positions, places, frame.positions, 3);
      scatter(rotations, places, frame.rotations, 4);
      scatter(resting, places, frame.resting, 1);
      if (errors !== undefined) scatter(errors, places, frame.errors, 1);
    }
    frame.changed = Uint32Array.from({ length: count }, (_, place) => place);
    return frame;
  }

  /** Frames that follow were not added: the next one is whole. */
  interrupt() {
    this.#whole = -Infinity;
  }

  clear() {
    this.#frames = [];
    this.#bytes = 0;
    this.#layout = undefined;
    this.#last = this.#whole = -Infinity;
  }
}

function gather(column, places, each) {
  const out = new column.constructor(places.length * each);
  for (let at = 0; at < places.length; at++) {
    const from = places[at] * each;
    for (let part = 0; part < each; part++) out[at * each + part] = column[from + part];
  }
  return out;
}

function scatter(values, places, column, each) {
  places.forEach((place, at) => {
    for (let part = 0; part < each; part++) column[place * each + part] = values[at * each + part];
  });
}
