// The stage: camera, light and ground, and the canvas that shows them.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

/** Where the camera stands in each scene of the demo, and where it looks; and in others. */
const VIEWS = {
  "ball-pit": [
    [17, 15, 20],
    [0, 2, 0],
  ],
  ragdolls: [
    [6, 5, 9],
    [0, 0.5, 0],
  ],
  cubes: [
    [9, 8, 14],
    [0, 0, 0],
  ],
  tumbler: [
    [0, 4, 16],
    [0, 0, 0],
  ],
  asteroids: [
    [38, 25, 50],
    [0, 0, 0],
  ],
};
const OTHERS = [
  [22, 17, 26],
  [0, 3, 0],
];

export class Stage {
  scene = new THREE.Scene();
  camera = new THREE.PerspectiveCamera(50, 1, 0.1, 2000);
  #renderer;
  #controls;
  #canvas;
  #pointer = new THREE.Vector2();
  #raycaster = new THREE.Raycaster();

  /** Throws if the browser has no WebGL 2. */
  constructor(canvas) {
    this.#canvas = canvas;
    this.#renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.#renderer.setPixelRatio(Math.min(globalThis.devicePixelRatio, 2));
    this.#controls = new OrbitControls(this.camera, canvas);
    this.#controls.enableDamping = false;
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8899aa, 1.6));
    const sun = new THREE.DirectionalLight(0xffffff, 1.8);
    sun.position.set(30, 60, 20);
    this.scene.add(sun);
    this.look(...OTHERS);
  }

  /** Puts the camera where a scene of this name is seen well. */
  lookAtScene(name) {
    this.look(...(VIEWS[name] ?? OTHERS));
  }

  /** Puts the camera at a point, looking at another. */
  look(from, at) {
    this.camera.position.set(...from);
    this.#controls.target.set(...at);
    this.#controls.update();
  }

  set turning(turning) {
    this.#controls.enabled = turning;
  }

  /** Draws. */
  draw() {
    const { clientWidth, clientHeight } = this.#canvas;
    const size = this.#renderer.getSize(new THREE.Vector2());
    if (clientWidth > 0 && (size.x !== clientWidth || size.y !== clientHeight)) {
      this.#renderer.setSize(clientWidth, clientHeight, false);
      this.camera.aspect = clientWidth / clientHeight;
      this.camera.updateProjectionMatrix();
    }
    this.#renderer.render(this.scene, this.camera);
  }

  /** The ray under a pointer. */
  ray({ clientX, clientY }) {
    const { left, top, width, height } = this.#canvas.getBoundingClientRect();
    this.#pointer.set((2 * (clientX - left)) / width - 1, 1 - (2 * (clientY - top)) / height);
    this.#raycaster.setFromCamera(this.#pointer, this.camera);
    return this.#raycaster;
  }

  /** Unit vector of the view. */
  get forward() {
    return this.camera.getWorldDirection(new THREE.Vector3());
  }
}
