// A ring around each body of which an update has just arrived. The bodies keep their colours.

import * as THREE from "three";

/** Seconds of a ring, its size at its beginning and end in radii of the body, and rings at most. */
const SECONDS = 0.35;
const FROM = 1.1;
const TO = 1.9;
const RINGS = 1024;
/** Radius of a ring's body at most, metres. */
const RADIUS_MAX = 5;

const VERTEX = `
attribute float radius;
attribute float strength;
uniform float pixels;
varying float shown;
void main() {
  vec4 at = modelViewMatrix * vec4(position, 1.0);
  gl_Position = projectionMatrix * at;
  gl_PointSize = projectionMatrix[1][1] * pixels * radius / -at.z;
  shown = strength;
}`;
const FRAGMENT = `
uniform vec3 colour;
varying float shown;
void main() {
  float away = 2.0 * length(gl_PointCoord - 0.5);
  float ring = smoothstep(0.7, 0.84, away) * (1.0 - smoothstep(0.9, 1.0, away));
  if (ring < 0.02) discard;
  gl_FragColor = vec4(colour, ring * shown);
}`;

export class Pulses {
  isOn = true;
  #layout;
  #updates = new Float64Array(0);
  /** For each place, seconds at which its ring began, NaN without one; and the places that have one. */
  #began = new Float64Array(0);
  #ringing = [];
  #points;

  /** Draws in the frame of these bodies. */
  constructor(bodies) {
    const geometry = new THREE.BufferGeometry();
    for (const [name, parts] of [["position", 3], ["radius", 1], ["strength", 1]])
      geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(parts * RINGS), parts));
    geometry.setDrawRange(0, 0);
    const uniforms = { pixels: { value: 1 }, colour: { value: new THREE.Color(0x000000) } };
    const options = { uniforms, vertexShader: VERTEX, fragmentShader: FRAGMENT, transparent: true, depthWrite: false };
    this.#points = new THREE.Points(geometry, new THREE.ShaderMaterial(options));
    this.#points.frustumCulled = false;
    bodies.draw(this.#points);
  }

  set colour(colour) {
    this.#points.material.uniforms.colour.value.set(colour);
  }

  /** Number of rings that are drawn. */
  get count() {
    return this.#points.geometry.drawRange.count;
  }

  /** Advances to a frame; `height`: that of the picture, pixels; `now` in seconds. */
  show({ layout, updateTicks, positions }, height, now) {
    if (layout !== this.#layout) {
      this.#layout = layout;
      this.#began = new Float64Array(layout.count).fill(NaN);
      this.#ringing.length = 0;
      this.#updates = Float64Array.from(updateTicks ?? []);
    }
    if (updateTicks !== undefined) this.#note(layout.movable, updateTicks, now);
    const { position, radius, strength } = this.#points.geometry.attributes;
    let count = 0;
    let kept = 0;
    for (const place of this.#ringing) {
      const share = (now - this.#began[place]) / SECONDS;
      if (share >= 1 || share < 0) {
        this.#began[place] = NaN;
        continue;
      }
      this.#ringing[kept++] = place;
      if (!this.isOn || count === RINGS) continue;
      for (let part = 0; part < 3; part++) position.array[3 * count + part] = positions[3 * place + part];
      radius.array[count] = Math.min(RADIUS_MAX, layout.radii[place]) * (FROM + (TO - FROM) * share);
      strength.array[count++] = 1 - share;
    }
    this.#ringing.length = kept;
    for (const column of [position, radius, strength]) column.needsUpdate = count > 0;
    this.#points.geometry.setDrawRange(0, count);
    this.#points.visible = count > 0;
    this.#points.material.uniforms.pixels.value = height;
  }

  #note(movable, updateTicks, now) {
    for (const place of movable) {
      if (updateTicks[place] === this.#updates[place]) continue;
      this.#updates[place] = updateTicks[place];
      if (!this.isOn) continue;
      if (Number.isNaN(this.#began[place])) this.#ringing.push(place);
      this.#began[place] = now;
    }
  }
}
