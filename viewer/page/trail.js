// The way of the picked body up to the moment that is shown; live with a mark where an update began.

import * as THREE from "three";

/** Points that are kept: four seconds at 60 ticks a second. */
const POINTS = 240;
/**
 * Between two frames: ticks, metres, and metres for each tick, beyond which the way begins anew: the body was put elsewhere.
 * A stream may be silent for 2.5 s.
 */
const GAP = 600;
const JUMP = 10;
const JUMP_PER_TICK = 2;

export class Trail {
  #points = [];
  #updateTick;
  #line = new THREE.Line(geometry(), new THREE.LineBasicMaterial());
  #marks = new THREE.Points(geometry(), new THREE.PointsMaterial({ size: 6, sizeAttenuation: false }));

  /** Draws in the frame of these bodies. */
  constructor(bodies) {
    for (const object of [this.#line, this.#marks]) {
      object.frustumCulled = false;
      bodies.draw(object);
    }
  }

  set colour(colour) {
    this.#line.material.color.set(colour);
    this.#marks.material.color.set(colour);
  }

  /** Number of points, and how many of them are marked. */
  get counts() {
    return { points: this.#points.length, marks: this.#points.filter(({ isMarked }) => isMarked).length };
  }

  clear() {
    this.#points = [];
    this.#updateTick = undefined;
    this.#draw();
  }

  /** Moves to a frame, forward or back. `place`: the body's, negative without a body. */
  show({ time, positions, updateTicks }, place) {
    if (place < 0) return this.#points.length > 0 && this.clear();
    if (time === this.#points.at(-1)?.time) return;
    let isMarked = false;
    while (this.#points.length > 0 && this.#points.at(-1).time >= time) {
      const later = this.#points.pop();
      if (later.time === time) isMarked = later.isMarked;
    }
    const position = positions.slice(3 * place, 3 * place + 3);
    if (this.#points.length > 0 && isApart(this.#points.at(-1), { time, position })) this.#points = [];
    this.#points.push({ time, isMarked, position });
    const updateTick = updateTicks?.[place];
    if (updateTick !== undefined && this.#updateTick !== undefined && updateTick !== this.#updateTick)
      (this.#points.find((point) => point.time >= updateTick) ?? this.#points.at(-1)).isMarked = true;
    this.#updateTick = updateTick;
    if (this.#points.length > POINTS) this.#points.shift();
    this.#draw();
  }

  #draw() {
    fill(this.#line.geometry, this.#points);
    const marked = this.#points.filter(({ isMarked }) => isMarked);
    fill(this.#marks.geometry, marked);
  }
}

function isApart(before, after) {
  const way = Math.hypot(...after.position.map((value, part) => value - before.position[part]));
  const ticks = after.time - before.time;
  return ticks > GAP || way > JUMP + JUMP_PER_TICK * ticks;
}

function geometry() {
  const made = new THREE.BufferGeometry();
  made.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * POINTS), 3));
  made.setDrawRange(0, 0);
  return made;
}

function fill(geometry, points) {
  const { position } = geometry.attributes;
  points.forEach((point, at) => position.array.set(point.position, 3 * at));
  position.needsUpdate = true;
  geometry.setDrawRange(0, points.length);
}
