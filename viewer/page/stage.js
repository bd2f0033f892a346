// The stage: one camera, one or two pictures beside each other, their light, and the canvas that shows them.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

/** Where the camera stands in each scene of the demo, and where it looks; and in others. */
const VIEWS = {
  "ball-pit": [
    [18, 16, 22],
    [0, 5, 0],
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
/** Degrees of the view's smaller angle; a picture that is narrower than this aspect sees as much to its sides. */
const ANGLE = 50;
const NARROW = 1.25;
/** Pixels between two pictures. */
const GAP = 2;
/** Edge of a shadow map, texels; the half edge of what has shadows, as a share of the camera's distance. */
const SHADOW_TEXELS = 2048;
const SHADOW_SHARE = 0.9;
/** Direction of the sun. */
const SUN = new THREE.Vector3(0.45, 0.85, 0.3).normalize();

/** One picture: a scene with its own light, and where it lies on the canvas. */
class Picture {
  scene = new THREE.Scene();
  sun = new THREE.DirectionalLight(0xffffff, 2.2);
  /** Pixels of the page, from the canvas's left and upper edges. */
  left = 0;
  top = 0;
  width = 0;
  height = 0;

  constructor() {
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x98a4b4, 1.5));
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(SHADOW_TEXELS, SHADOW_TEXELS);
    this.sun.shadow.normalBias = 0.05;
    this.scene.add(this.sun, this.sun.target);
    this.scene.fog = new THREE.Fog(0xffffff, 60, 240);
  }

  /** Lets the shadows fall around a point that the camera sees from a distance. */
  light(at, distance) {
    const { camera } = this.sun.shadow;
    const half = Math.max(4, distance * SHADOW_SHARE);
    this.sun.target.position.copy(at);
    this.sun.position.copy(at).addScaledVector(SUN, 3 * half);
    if (camera.right === half) return;
    Object.assign(camera, { left: -half, right: half, bottom: -half, top: half, near: 0.1, far: 6 * half });
    camera.updateProjectionMatrix();
  }
}

export class Stage {
  camera = new THREE.PerspectiveCamera(ANGLE, 1, 0.1, 2000);
  pictures = [];
  #renderer;
  #controls;
  #canvas;
  /** Pixels of the page. */
  #width = 0;
  #height = 0;
  #pointer = new THREE.Vector2();
  #raycaster = new THREE.Raycaster();

  /** Throws if the browser has no WebGL 2. `count` pictures can be shown; all are, unless `shown` says otherwise. */
  constructor(canvas, count) {
    this.#canvas = canvas;
    this.#renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.#renderer.setPixelRatio(Math.min(globalThis.devicePixelRatio, 2));
    this.#renderer.setScissorTest(true);
    this.#renderer.shadowMap.enabled = true;
    this.#controls = new OrbitControls(this.camera, canvas);
    this.#controls.enableDamping = false;
    this.pictures = Array.from({ length: count }, () => new Picture());
    this.shown = this.pictures;
    this.look(...OTHERS);
    // To read a size in each frame would have the page laid out twice in it.
    new ResizeObserver(() => this.#measure()).observe(canvas);
  }

  #measure() {
    [this.#width, this.#height] = [this.#canvas.clientWidth, this.#canvas.clientHeight];
    this.#renderer.setSize(this.#width, this.#height, false);
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

  set shadows(shadows) {
    for (const { sun } of this.pictures) sun.castShadow = shadows;
  }

  /** The colour behind everything, in which what is far away is lost. */
  set ground(colour) {
    for (const { scene } of this.pictures) {
      scene.background = new THREE.Color(colour);
      scene.fog.color.set(colour);
    }
  }

  /** Draws the pictures that are shown. */
  draw() {
    if (this.#width === 0 || this.#height === 0) return;
    this.#arrange(this.#width, this.#height);
    const { target } = this.#controls;
    const distance = this.camera.position.distanceTo(target);
    for (const picture of this.shown) {
      const { left, top, width, height, scene, sun } = picture;
      if (sun.castShadow) picture.light(target, distance);
      scene.fog.near = 2 * distance;
      scene.fog.far = 8 * distance;
      // The renderer counts from below.
      const place = [left, this.#height - top - height, width, height];
      this.#renderer.setViewport(...place);
      this.#renderer.setScissor(...place);
      this.#renderer.render(scene, this.camera);
    }
  }

  /** Places the pictures side by side, or one above the other where the canvas is high. */
  #arrange(width, height) {
    const count = this.shown.length;
    const isHigh = height > width;
    const each = isHigh ? [width, (height - GAP * (count - 1)) / count] : [(width - GAP * (count - 1)) / count, height];
    this.shown.forEach((picture, at) => {
      picture.left = isHigh ? 0 : at * (each[0] + GAP);
      picture.top = isHigh ? at * (each[1] + GAP) : 0;
      [picture.width, picture.height] = each;
    });
    const aspect = each[0] / each[1];
    if (this.camera.aspect === aspect) return;
    const half = Math.tan((ANGLE * Math.PI) / 360) * Math.max(1, NARROW / aspect);
    this.camera.fov = (Math.atan(half) * 360) / Math.PI;
    this.camera.aspect = aspect;
    this.camera.updateProjectionMatrix();
  }

  /** The picture under a pointer. */
  pictureAt({ clientX, clientY }) {
    const { left, top } = this.#canvas.getBoundingClientRect();
    const within = ({ left: x, top: y, width, height }) =>
      clientX - left >= x && clientX - left < x + width && clientY - top >= y && clientY - top < y + height;
    return this.shown.find(within) ?? this.shown.at(-1);
  }

  /** The ray under a pointer, in one of the pictures. */
  ray(event, picture = this.pictureAt(event)) {
    const { left, top } = this.#canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - left - picture.left, event.clientY - top - picture.top];
    this.#pointer.set((2 * x) / picture.width - 1, 1 - (2 * y) / picture.height);
    this.#raycaster.setFromCamera(this.#pointer, this.camera);
    return this.#raycaster;
  }

  /** Where a point of a picture's scene is seen, pixels of the page. */
  screenOf(point, picture) {
    const { left, top } = this.#canvas.getBoundingClientRect();
    const seen = new THREE.Vector3(...point).project(this.camera);
    return [
      left + picture.left + ((seen.x + 1) / 2) * picture.width,
      top + picture.top + ((1 - seen.y) / 2) * picture.height,
    ];
  }

  /** Unit vector of the view. */
  get forward() {
    return this.camera.getWorldDirection(new THREE.Vector3());
  }
}
