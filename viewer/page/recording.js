// A recording that is played in the place of a live scene.

import { decompress } from "./fzstd/fzstd.js";
import { readMcap } from "./mcap.js";
import { readRhtrace } from "./rhtrace.js";

/** Ticks between states that are kept whole, to go back to. */
const WHOLE = 120;
/** Where bodies are that are not in the scene yet, or no more, metres. */
export const AWAY = 1e7;

/** Reads a file; throws an error whose message says what is wrong with it. */
export async function openRecording(file) {
  let bytes = new Uint8Array(await file.arrayBuffer());
  if (begins(bytes, [0x28, 0xb5, 0x2f, 0xfd])) bytes = decompress(bytes);
  if (begins(bytes, [0x89, 0x4d, 0x43, 0x41, 0x50])) return new Recording(file.name, readMcap(bytes));
  if (begins(bytes, [0x52, 0x48, 0x54, 0x52, 0x41, 0x43, 0x45, 0x31]))
    return new Recording(file.name, readRhtrace(bytes));
  throw new Error("it is neither an MCAP file nor an .rhtrace");
}

const begins = (bytes, magic) => magic.every((byte, at) => bytes[at] === byte);

/**
 * Plays ticks of changes.
 *
 * `bodies`: kind and shape of each body. `ticks`: for each tick the bodies that changed (`places`), their `positions`,
 * `rotations` and `resting`, and the bodies that have come to rest (`rested`) or are `removed`. `errors` and
 * `tolerance` where a copy is compared with the truth.
 */
class Recording {
  #ticks;
  #step;
  #tick = -1;
  #whole = [];
  #frame;
  #changed = new Set();

  constructor(name, { bodies, ticks, step, tolerance, what, gravity = [0, -1, 0] }) {
    this.#ticks = ticks;
    this.#step = step;
    this.title = `${name}: ${what}`;
    this.gravity = gravity;
    /** Seconds. */
    this.length = (ticks.length - 1) * step;
    const count = bodies.length;
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
    this.#frame = {
      count,
      generation: `recording ${name} ${performance.now()}`,
      ids: Float64Array.from({ length: count }, (_, place) => place),
      kinds: Uint8Array.from(bodies, ({ kind }) => kind),
      shapeNumbers,
      shapesByNumber,
      positions: new Float32Array(3 * count).fill(AWAY),
      rotations: new Float32Array(4 * count),
      resting: new Uint8Array(count).fill(1),
      tolerances: new Float32Array(count).fill(tolerance ?? NaN),
      errors: new Float32Array(count).fill(NaN),
    };
    for (let place = 0; place < count; place++) this.#frame.rotations[4 * place + 3] = 1;
  }

  /** The frame at a time in seconds. */
  frame(at) {
    const wanted = Math.max(0, Math.min(this.#ticks.length - 1, Math.round(at / this.#step)));
    if (wanted < this.#tick) this.#goBack(wanted);
    while (this.#tick < wanted) this.#advance();
    this.#frame.time = this.#tick;
    this.#frame.changed = Uint32Array.from(this.#changed);
    this.#changed.clear();
    return this.#frame;
  }

  #advance() {
    if ((this.#tick + 1) % WHOLE === 0 && this.#whole.length === (this.#tick + 1) / WHOLE) {
      const { positions, rotations, resting, errors } = this.#frame;
      this.#whole.push({
        positions: positions.slice(),
        rotations: rotations.slice(),
        resting: resting.slice(),
        errors: errors.slice(),
      });
    }
    this.#tick++;
    const { places, positions, rotations, resting, errors, removed, rested = [] } = this.#ticks[this.#tick];
    const frame = this.#frame;
    places.forEach((place, at) => {
      frame.positions.set(positions.subarray(3 * at, 3 * at + 3), 3 * place);
      frame.rotations.set(rotations.subarray(4 * at, 4 * at + 4), 4 * place);
      frame.resting[place] = resting[at];
      this.#changed.add(place);
    });
    errors?.forEach((error, at) => (frame.errors[places[at]] = error));
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
    for (let place = 0; place < this.#frame.count; place++) this.#changed.add(place);
  }
}
