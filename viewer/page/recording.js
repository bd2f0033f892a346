// A recording that is played in the place of a live scene: the truth, or a copy beside a sender of full states.

import { decompress } from "./fzstd/fzstd.js";
import { errorsOf } from "./comparison.js";
import { readMcap } from "./mcap.js";
import { readRhtrace } from "./rhtrace.js";
import { AWAY, layoutOf } from "./roster.js";
import { Sender, STATE_BYTES } from "./sender.js";

/** Ticks between states that are kept whole, to go back to. */
const WHOLE = 120;

/** Reads a file of this name; throws an error whose message says what is wrong with it. */
export async function openRecording(name, buffer) {
  let bytes = new Uint8Array(buffer);
  if (begins(bytes, [0x28, 0xb5, 0x2f, 0xfd])) bytes = decompress(bytes);
  if (begins(bytes, [0x89, 0x4d, 0x43, 0x41, 0x50])) return new RecordingFile(name, readMcap(bytes));
  if (begins(bytes, [0x52, 0x48, 0x54, 0x52, 0x41, 0x43, 0x45, 0x31])) {
    const read = readRhtrace(bytes);
    return new RecordingFile(name, { loads: [{ name: "", runs: [] }], open: () => read });
  }
  throw new Error("it is neither an MCAP file nor an .rhtrace");
}

const begins = (bytes, magic) => magic.every((byte, at) => bytes[at] === byte);

/** A file with one load or several, each with the copies of some runs. */
class RecordingFile {
  #open;
  name;
  loads;

  constructor(name, { loads, open }) {
    this.name = name;
    this.loads = loads;
    this.#open = open;
  }

  /** The recording of a load and one of its runs; without names that the file has, of the first ones. */
  recording(loadName, runName) {
    const load = this.loads.find(({ name }) => name === loadName) ?? this.loads[0];
    const run = load.runs.find((name) => name === runName) ?? load.runs[0];
    return new Recording(this.name, load.name, run, this.#open(load.name, run));
  }
}

/**
 * Plays ticks of changes.
 *
 * `bodies`: kind and shape of each body. `ticks`: for each tick of the truth the bodies that changed (`places`), their
 * `positions`, `rotations` and `resting`, and the bodies that have come to rest (`rested`) or are `removed`. `copy` and `bytes`
 * where a copy is compared with it: its ticks in the same form, and the bytes that it had received at each.
 */
class Recording {
  #truth;
  #copy;
  #sent;
  #bytes;
  #naive;
  #layout;
  #errors;
  #sentErrors;
  #step;

  constructor(name, load, run, { bodies, ticks, copy, bytes, step, tolerance, what, gravity = [0, -1, 0] }) {
    this.#step = step;
    this.title = `${name}: ${what}`;
    this.load = load;
    this.run = run;
    this.gravity = gravity;
    this.tolerance = tolerance;
    /** Seconds. */
    this.length = (ticks.length - 1) * step;
    this.#layout = layoutOfBodies(bodies);
    this.#truth = new Track(ticks, this.#layout, tolerance);
    if (copy === undefined) return;
    this.#bytes = bytes;
    this.#copy = new Track(copy, this.#layout, tolerance);
    const sent = whatASenderSends(new Track(ticks, this.#layout), ticks, bytes);
    this.#naive = sent.naive;
    this.#sent = new Track(sent.ticks, this.#layout, tolerance);
    this.#errors = new Float32Array(bodies.length);
    this.#sentErrors = new Float32Array(bodies.length);
  }

  /** True if there is a copy, and so a sender of full states beside it. */
  get isCompared() {
    return this.#copy !== undefined;
  }

  /** Seconds of a tick. */
  get step() {
    return this.#step;
  }

  /**
   * The picture at a time in seconds: the `frame`, and with a copy its `errors`, the greatest (`worst`), the truth of that tick
   * (`actual`), the `bytes` received up to then, and those of full states of all bodies (`naive`); `beside`, the frame of the
   * sender of full states, with its own.
   */
  at(seconds) {
    const tick = Math.max(0, Math.min(this.#truth.length - 1, Math.round(seconds / this.#step)));
    const actual = this.#truth.frame(tick);
    if (this.#copy === undefined) return { frame: actual };
    const frame = this.#copy.frame(tick);
    const sent = this.#sent.frame(tick);
    const worst = errorsOf(frame, actual, this.#layout, this.#errors);
    const besideWorst = errorsOf(sent, actual, this.#layout, this.#sentErrors);
    return {
      frame,
      errors: this.#errors,
      worst,
      actual,
      bytes: this.#bytes[tick],
      naive: this.#naive[tick],
      beside: { frame: sent, errors: this.#sentErrors, worst: besideWorst, actual },
    };
  }
}

function layoutOfBodies(bodies) {
  const shapesByNumber = new Map();
  const numbers = new Map();
  const shapeNumbers = Uint32Array.from(bodies, ({ shape }) => {
    const key = JSON.stringify(shape);
    if (!numbers.has(key)) {
      numbers.set(key, numbers.size);
      shapesByNumber.set(numbers.get(key), shape);
    }
    return numbers.get(key);
  });
  const ids = Float64Array.from(bodies.keys());
  const kinds = Uint8Array.from(bodies, ({ kind }) => kind);
  return layoutOf({ count: bodies.length, ids, kinds, shapeNumbers, shapesByNumber });
}

/**
 * The ticks of a sender of full states that has the bytes of a copy, and the bytes up to each tick that full states of all bodies
 * take.
 */
function whatASenderSends(truth, ticks, bytes) {
  const sender = new Sender();
  const naive = new Float64Array(ticks.length);
  const sent = ticks.map((_, tick) => {
    const { layout, positions, rotations, resting, changed } = truth.frame(tick);
    const isThere = (place) => positions[3 * place] !== AWAY;
    const isShown = (place) => sender.positions[3 * place] !== AWAY;
    const state = { tick, positions, rotations, layout };
    // The bytes of the first tick were for joining.
    if (tick === 0) sender.send(state, 0);
    const moved = tick === 0 ? Array.from(changed) : Array.from(changed).filter((place) => isThere(place) !== isShown(place));
    for (const place of moved) sender.place(place, state);
    const places = [...moved, ...(tick === 0 ? [] : sender.send(state, bytes[tick] - bytes[tick - 1]))];
    let count = 0;
    for (const place of layout.movable) if (isThere(place)) count++;
    naive[tick] = (tick === 0 ? 0 : naive[tick - 1]) + count * STATE_BYTES;
    const of = (column, each) => column.constructor.from(places.flatMap((place) => [...column.subarray(each * place, each * (place + 1))]));
    return { places, positions: of(positions, 3), rotations: of(rotations, 4), resting: of(resting, 1), removed: [], isStamped: true };
  });
  return { ticks: sent, naive };
}

/** The frames of ticks of changes, forwards and back. */
class Track {
  #ticks;
  #tick = -1;
  #whole = [];
  #frame;
  #changed = new Set();

  constructor(ticks, layout, tolerance) {
    this.#ticks = ticks;
    const { count } = layout;
    this.#frame = {
      layout,
      // As a live frame has them.
      ids: layout.ids,
      kinds: layout.kinds,
      positions: new Float32Array(3 * count).fill(AWAY),
      rotations: new Float32Array(4 * count),
      resting: new Uint8Array(count).fill(1),
      tolerances: new Float32Array(count).fill(tolerance ?? NaN),
      updateTicks: ticks.some(({ isStamped }) => isStamped) ? new Float64Array(count) : undefined,
    };
    for (let place = 0; place < count; place++) this.#frame.rotations[4 * place + 3] = 1;
  }

  /** Number of ticks. */
  get length() {
    return this.#ticks.length;
  }

  /** The frame of a tick; until the next call. */
  frame(wanted) {
    if (wanted < this.#tick) this.#goBack(wanted);
    while (this.#tick < wanted) this.#advance();
    this.#frame.time = this.#tick;
    this.#frame.changed = Uint32Array.from(this.#changed);
    this.#changed.clear();
    return this.#frame;
  }

  #advance() {
    const frame = this.#frame;
    if ((this.#tick + 1) % WHOLE === 0 && this.#whole.length === (this.#tick + 1) / WHOLE) {
      const { positions, rotations, resting, updateTicks } = frame;
      this.#whole.push({
        positions: positions.slice(),
        rotations: rotations.slice(),
        resting: resting.slice(),
        ...(updateTicks && { updateTicks: updateTicks.slice() }),
      });
    }
    this.#tick++;
    const { places, positions, rotations, resting, removed, rested = [] } = this.#ticks[this.#tick];
    places.forEach((place, at) => {
      frame.positions.set(positions.subarray(3 * at, 3 * at + 3), 3 * place);
      frame.rotations.set(rotations.subarray(4 * at, 4 * at + 4), 4 * place);
      frame.resting[place] = resting[at];
      if (frame.updateTicks) frame.updateTicks[place] = this.#tick;
      this.#changed.add(place);
    });
    for (const place of rested) frame.resting[place] = 1;
    for (const place of removed) {
      frame.positions.fill(AWAY, 3 * place, 3 * place + 3);
      this.#changed.add(place);
    }
  }

  #goBack(wanted) {
    const number = Math.floor(wanted / WHOLE);
    for (const [name, column] of Object.entries(this.#whole[number])) this.#frame[name].set(column);
    this.#tick = number * WHOLE - 1;
    for (let place = 0; place < this.#frame.layout.count; place++) this.#changed.add(place);
  }
}
