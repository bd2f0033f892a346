// Writes recordings of boxes as `.rhtrace`: spec/RHTRACE.md has the layout.
import { writeFileSync } from "node:fs";

export class Trace {
  #bytes = [];
  #frames = 0;

  /** engine: hertz, substeps, gravity, formula. bodies: half, damping, gyroscopic, and moments if they are known. */
  constructor({ hertz, substeps = 1, gravity, formula }, bodies) {
    this.bodies = bodies.length;
    this.#text("RHTRACE2");
    this.#u32(this.bodies, 0, hertz, 1, substeps);
    this.#f32(...gravity);
    this.#u8(formula, 0);
    for (const { half, damping, gyroscopic, moments } of bodies) {
      this.#u8(1, (gyroscopic ? 1 : 0) | (moments ? 2 : 0));
      this.#f32(...damping, 1, 0, 0, 0);
      if (moments) this.#f32(...moments, 0, 0, 0, 1);
      this.#u8(2);
      this.#f32(...half);
    }
  }

  /** States of all bodies: position 3, quaternion x y z w, linear velocity 3, angular velocity 3, world axes. */
  frame(states) {
    this.#frames += 1;
    this.#u32(states.length);
    states.forEach((state, body) => {
      this.#u32(body);
      this.#f32(...state);
      this.#u8(1);
    });
  }

  write(path) {
    const whole = Buffer.concat(this.#bytes);
    whole.writeUInt32LE(this.#frames, 12);
    writeFileSync(path, whole);
  }

  #text(text) { this.#bytes.push(Buffer.from(text)); }
  #u8(...numbers) { this.#bytes.push(Buffer.from(numbers)); }
  #u32(...numbers) { this.#bytes.push(Buffer.from(new Uint32Array(numbers).buffer)); }
  #f32(...numbers) { this.#bytes.push(Buffer.from(new Float32Array(numbers).buffer)); }
}

/** Sixty boxes of one seed: half extents, place, velocity, spin. */
export function boxes() {
  let state = 1;
  const uniform = (least, most) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return least + (most - least) * (state / 2 ** 32);
  };
  const three = (least, most) => [uniform(least, most), uniform(least, most), uniform(least, most)];
  return Array.from({ length: 60 }, (_, i) => ({
    half: three(0.1, 0.4),
    at: [3 * (i % 10), 60, 3 * Math.floor(i / 10)],
    linear: three(-2, 2),
    angular: three(-6, 6),
  }));
}
