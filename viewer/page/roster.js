// The bodies of the live copy: their shapes, kinds and radii. They change seldom, and are copied out of its memory.

import { boundingRadius } from "./shapes.js";

const STATIC = 0;

export class Roster {
  generation;
  count = 0;
  shapeNumbers = new Uint32Array(0);
  kinds = new Uint8Array(0);
  /** Shapes by their numbers. */
  shapes = new Map();
  /** Bounding radius of each place, metres. */
  radii = new Float32Array(0);
  /** Places of the bodies that are not static. */
  movable = new Uint32Array(0);
  #source;

  /** Reads a frame's bodies, if they are others than before. `source` has their shapes. */
  read({ generation, count, shapes, kinds }, source) {
    if (generation === this.generation && source === this.#source) return;
    this.generation = generation;
    this.#source = source;
    this.count = count;
    this.shapeNumbers = shapes.slice();
    this.kinds = kinds.slice();
    this.shapes = new Map();
    const radii = new Map();
    for (const shape of new Set(this.shapeNumbers)) {
      this.shapes.set(shape, source.shape(shape));
      radii.set(shape, boundingRadius(this.shapes.get(shape)));
    }
    this.radii = Float32Array.from(this.shapeNumbers, (shape) => radii.get(shape));
    this.movable = Uint32Array.from(this.kinds.keys()).filter((place) => this.kinds[place] !== STATIC);
  }
}
