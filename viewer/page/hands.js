// Hands: throw, drop, carry and drive, as commands of an ordinary member.

import * as THREE from "three";

/** Speed of a thrown ball, m/s; radius, metres; density, kg/m³. */
const THROW_SPEED = 30;
const BALL = { kind: "ball", radius: 0.6 };
const BOX = { kind: "cuboid", halfExtents: [0.5, 0.5, 0.5] };
const MATERIAL = { friction: 0.4, restitution: 0.1, density: 1000 };
/** Metres above the ground from which a box falls. */
const DROP_HEIGHT = 12;
/** How fast a carried body follows the pointer, 1/s, and its greatest speed, m/s. */
const GRIP = 10;
const CARRY_SPEED = 40;
/** The player: impulse of a second, N·s; cruising speed, m/s; impulse of a jump, N·s. Its mass is 3.4 kg. */
const DRIVE = 120;
const CRUISE = 9;
const JUMP = 28;
const DRIVING = { KeyW: [0, 1], KeyS: [0, -1], KeyA: [-1, 0], KeyD: [1, 0] };

export class Hands {
  #stage;
  #live;
  #held = new Set();
  #jumps = false;
  #carried;
  #pointer;
  #picture;
  #plane = new THREE.Plane();
  #added = [];
  /** Called with a sentence if a command is not possible. */
  onerror = () => {};

  constructor(stage, live) {
    this.#stage = stage;
    this.#live = live;
  }

  #try(act) {
    const { copy } = this.#live;
    if (copy === undefined || copy.state !== "open") return;
    try {
      act(copy);
    } catch (cause) {
      this.onerror(cause.code === "noIds" ? "The server grants more ids first. Try again." : cause.message);
    }
  }

  throwBall() {
    this.#try((copy) => {
      const { forward, camera } = this.#stage;
      const from = camera.position.clone().addScaledVector(forward, 2);
      const linearVelocity = forward.multiplyScalar(THROW_SPEED).toArray();
      const body = { kind: "dynamic", shape: BALL, material: MATERIAL, position: from.toArray(), linearVelocity };
      this.#added.push(copy.addBody(body));
    });
  }

  dropBox() {
    this.#try((copy) => {
      const { camera, forward } = this.#stage;
      // Where the view meets the ground, or at some distance.
      const steps = forward.y < -0.05 ? Math.min(60, -camera.position.y / forward.y) : 20;
      const at = camera.position.clone().addScaledVector(forward, steps);
      const body = { kind: "dynamic", shape: BOX, material: MATERIAL, position: [at.x, DROP_HEIGHT, at.z] };
      this.#added.push(copy.addBody(body));
    });
  }

  /** Removes a body, or the last one that these hands added. */
  remove(id) {
    const last = id ?? this.#added.pop();
    if (last !== undefined) this.#try((copy) => copy.command({ kind: "removeBody", id: last }));
  }

  /** Begins to carry a body that the pointer has hit at a point, in one of the pictures. */
  carry(id, point, event, picture) {
    this.#carried = id;
    this.#picture = picture;
    this.#pointer = event;
    this.#plane.setFromNormalAndCoplanarPoint(this.#stage.forward.negate(), point);
    this.#stage.turning = false;
  }

  move(event) {
    if (this.#carried !== undefined) this.#pointer = event;
  }

  /** Lets go: the body keeps its velocity. */
  drop() {
    this.#carried = undefined;
    this.#stage.turning = true;
  }

  /** The id of the last body that these hands added and have not removed. */
  get lastAdded() {
    return this.#added.at(-1);
  }

  /** The id of the body that is carried; undefined if none is. */
  get carried() {
    return this.#carried;
  }

  /** Notes a key of the player; false if it is none. */
  press(code) {
    if (code === "KeyQ") this.#jumps = true;
    else if (code in DRIVING) this.#held.add(code);
    else return false;
    return true;
  }

  release(code) {
    this.#held.delete(code);
  }

  releaseAll() {
    this.#held.clear();
    this.drop();
  }

  /** Forgets the bodies that it added: the scene is another one. */
  restart() {
    this.#added = [];
    this.drop();
  }

  /** Acts once in each frame, `seconds` after the last one; `player` is the id of the body that keys drive. */
  act(frame, velocities, seconds, player) {
    const commands = [...this.#carrying(frame), ...this.#driving(frame.layout, velocities, seconds, player)];
    if (commands.length > 0) this.#try((copy) => commands.forEach((command) => copy.command(command)));
  }

  #carrying({ layout, positions }) {
    const place = this.#carried === undefined ? -1 : (layout.places.get(this.#carried) ?? -1);
    if (place < 0) return [];
    const target = this.#stage.ray(this.#pointer, this.#picture).ray.intersectPlane(this.#plane, new THREE.Vector3());
    if (target === null) return [];
    const linear = target.sub(new THREE.Vector3().fromArray(positions, 3 * place)).multiplyScalar(GRIP);
    linear.clampLength(0, CARRY_SPEED);
    return [{ kind: "setVelocity", id: this.#carried, linear: linear.toArray(), angular: [0, 0, 0] }];
  }

  #driving({ places }, linearVelocities, seconds, player) {
    const place = player === undefined ? -1 : (places.get(player) ?? -1);
    if (place < 0) return [];
    const commands = [];
    if (this.#jumps) commands.push({ kind: "impulse", id: player, impulse: [0, JUMP, 0] });
    this.#jumps = false;
    const forward = this.#stage.forward.setY(0).normalize();
    const right = new THREE.Vector3(-forward.z, 0, forward.x);
    const way = new THREE.Vector3();
    for (const code of this.#held)
      way.addScaledVector(right, DRIVING[code][0]).addScaledVector(forward, DRIVING[code][1]);
    if (way.lengthSq() > 0.01) {
      way.normalize();
      const velocity = new THREE.Vector3().fromArray(linearVelocities, 3 * place);
      if (velocity.dot(way) < CRUISE) {
        const impulse = way.multiplyScalar(DRIVE * Math.min(seconds, 0.1));
        commands.push({ kind: "impulse", id: player, impulse: impulse.toArray() });
      }
    }
    return commands;
  }
}
