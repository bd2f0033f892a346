// A line from each body that is off to the place where it should be.

import * as THREE from "three";

/** Share of its tolerance from which a body has a line; and lines at most. */
const SHARE = 0.5;
const LINES = 4096;

export class Offsets {
  isOn = true;
  #lines;

  /** Draws in the frame of these bodies. */
  constructor(bodies) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(6 * LINES), 3));
    geometry.setDrawRange(0, 0);
    // Through the bodies: a line of centimetres lies inside of its body.
    const material = new THREE.LineBasicMaterial({ transparent: true, opacity: 0.35, depthTest: false });
    this.#lines = new THREE.LineSegments(geometry, material);
    this.#lines.frustumCulled = false;
    bodies.draw(this.#lines);
  }

  set colour(colour) {
    this.#lines.material.color.set(colour);
  }

  /** Number of lines that are drawn. */
  get count() {
    return this.#lines.geometry.drawRange.count / 2;
  }

  /** The ends of the lines, six numbers each: where a body is shown, and where it should be. */
  get ends() {
    return this.#lines.geometry.attributes.position.array.subarray(0, 6 * this.count);
  }

  /** Shows lines for poses and the truth of the same tick, each with its bodies; without a truth, none. */
  show(shown, layout, errors, tolerances, actual) {
    const { position } = this.#lines.geometry.attributes;
    let count = 0;
    if (this.isOn && actual !== undefined) {
      const isOther = actual.layout !== layout;
      for (const place of layout.movable) {
        if (!(errors[place] > SHARE * tolerances[place]) || count === LINES) continue;
        const other = isOther ? actual.layout.places.get(layout.ids[place]) : place;
        if (other === undefined) continue;
        for (let part = 0; part < 3; part++) {
          position.array[6 * count + part] = shown.positions[3 * place + part];
          position.array[6 * count + 3 + part] = actual.positions[3 * other + part];
        }
        count++;
      }
    }
    position.needsUpdate = count > 0;
    this.#lines.geometry.setDrawRange(0, 2 * count);
    this.#lines.visible = count > 0;
  }
}
