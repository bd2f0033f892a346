// The bodies of one view as instances: one mesh for each shape, one instance for each body.

import * as THREE from "three";
import { geometryOf } from "./shapes.js";

/** Bodies beyond which round surfaces have fewer triangles. */
const MANY = 3000;
const STATIC = 0;
const DYNAMIC = 1;
/** How many times wider than high a cuboid is that counts as a ground. */
const FLAT = 4;

export class Bodies {
  #group = new THREE.Group();
  #meshes = [];
  /** For each place: number of its mesh, and of its instance. */
  #mesh = new Uint32Array(0);
  #instance = new Uint32Array(0);
  #material = new THREE.MeshLambertMaterial();
  /** Grounds are whole; walls, and bodies that a script moves, are often before or around the others. */
  #groundMaterial = new THREE.MeshLambertMaterial();
  #wallMaterial = new THREE.MeshLambertMaterial({ transparent: true, opacity: 0.35, depthWrite: false });
  #kinematicMaterial = new THREE.MeshLambertMaterial({ transparent: true, opacity: 0.4, depthWrite: false });
  /** Places of the bodies that are not static. */
  movable = new Uint32Array(0);

  constructor(scene) {
    scene.add(this.#group);
  }

  /** Draws an object in the frame of these bodies. */
  draw(object) {
    this.#group.add(object);
  }

  /** Turns all bodies so that a direction points down. */
  set down(direction) {
    const down = new THREE.Vector3(...direction);
    if (down.lengthSq() === 0) down.set(0, -1, 0);
    this.#group.quaternion.setFromUnitVectors(down.normalize(), new THREE.Vector3(0, -1, 0));
  }

  set staticColour(colour) {
    this.#groundMaterial.color.set(colour);
    this.#wallMaterial.color.set(colour);
  }

  /** Makes the meshes for these bodies. */
  layout({ count, shapeNumbers, shapesByNumber, kinds, movable }) {
    this.#clear();
    const groups = new Map();
    this.#mesh = new Uint32Array(count);
    this.#instance = new Uint32Array(count);
    for (let place = 0; place < count; place++) {
      const kind = kinds[place];
      const key = 3 * shapeNumbers[place] + kind;
      if (!groups.has(key)) groups.set(key, []);
      groups.get(key).push(place);
    }
    const detail = count > MANY ? 1 : 2;
    for (const [key, places] of groups) {
      const kind = key % 3;
      const shape = shapesByNumber.get((key - kind) / 3);
      const still = isGround(shape) ? this.#groundMaterial : this.#wallMaterial;
      const material = [still, this.#material, this.#kinematicMaterial][kind];
      const mesh = new THREE.InstancedMesh(geometryOf(shape, detail), material, places.length);
      mesh.frustumCulled = false;
      mesh.castShadow = kind === DYNAMIC;
      mesh.receiveShadow = true;
      mesh.userData.places = places;
      places.forEach((place, instance) => {
        this.#mesh[place] = this.#meshes.length + 1;
        this.#instance[place] = instance;
        if (kind !== STATIC) mesh.setColorAt(instance, MOVABLE_COLOUR);
      });
      this.#meshes.push(mesh);
      this.#group.add(mesh);
    }
    this.movable = movable;
  }

  /** Puts bodies where a frame has them: those of these places. */
  pose({ positions, rotations }, places) {
    for (const place of places) {
      const number = this.#mesh[place];
      if (number === 0) continue;
      const mesh = this.#meshes[number - 1];
      write(mesh.instanceMatrix.array, 16 * this.#instance[place], positions, 3 * place, rotations, 4 * place);
      mesh.instanceMatrix.needsUpdate = true;
    }
  }

  /** Where a body is drawn, in the frame of the scene; undefined if it is not drawn. */
  drawnPosition(place) {
    const number = this.#mesh[place];
    if (!number) return undefined;
    const { array } = this.#meshes[number - 1].instanceMatrix;
    const at = 16 * this.#instance[place];
    // The matrix of an instance that was never placed is zero.
    return array[at + 15] === 0 ? undefined : Array.from(array.subarray(at + 12, at + 15));
  }

  /** The colour that a body is drawn in. */
  drawnColour(place) {
    const { instanceColor } = this.#meshes[this.#mesh[place] - 1];
    return Array.from(instanceColor.array.subarray(3 * this.#instance[place], 3 * this.#instance[place] + 3));
  }

  /** Colours a body; red, green and blue from 0 to 1. */
  colour(place, red, green, blue) {
    const number = this.#mesh[place];
    if (number === 0) return;
    const { instanceColor } = this.#meshes[number - 1];
    const at = 3 * this.#instance[place];
    instanceColor.array[at] = red;
    instanceColor.array[at + 1] = green;
    instanceColor.array[at + 2] = blue;
    instanceColor.needsUpdate = true;
  }

  /** The place of the first body that a ray hits, and where; undefined if it hits none that can move. */
  pick(raycaster) {
    for (const mesh of this.#meshes) mesh.boundingSphere = null;
    const movable = this.#meshes.filter(({ instanceColor }) => instanceColor !== null);
    const hit = raycaster.intersectObjects(movable, false)[0];
    return hit && { place: hit.object.userData.places[hit.instanceId], point: hit.point };
  }

  #clear() {
    for (const mesh of this.#meshes) {
      this.#group.remove(mesh);
      mesh.geometry.dispose();
      mesh.dispose();
    }
    this.#meshes = [];
  }
}

const MOVABLE_COLOUR = new THREE.Color(0x4f9fd8);

/** True for a static body that others lie on and that hides none of them. */
function isGround({ kind, halfExtents }) {
  if (kind === "cuboid") return Math.min(halfExtents[0], halfExtents[2]) > FLAT * halfExtents[1];
  return kind === "halfSpace" || kind === "heights" || kind === "mesh";
}

/** Writes the matrix of a rotation and a translation, column by column. */
function write(matrix, at, positions, p, rotations, r) {
  const x = rotations[r],
    y = rotations[r + 1],
    z = rotations[r + 2],
    w = rotations[r + 3];
  matrix[at] = 1 - 2 * (y * y + z * z);
  matrix[at + 1] = 2 * (x * y + z * w);
  matrix[at + 2] = 2 * (x * z - y * w);
  matrix[at + 3] = 0;
  matrix[at + 4] = 2 * (x * y - z * w);
  matrix[at + 5] = 1 - 2 * (x * x + z * z);
  matrix[at + 6] = 2 * (y * z + x * w);
  matrix[at + 7] = 0;
  matrix[at + 8] = 2 * (x * z + y * w);
  matrix[at + 9] = 2 * (y * z - x * w);
  matrix[at + 10] = 1 - 2 * (x * x + y * y);
  matrix[at + 11] = 0;
  matrix[at + 12] = positions[p];
  matrix[at + 13] = positions[p + 1];
  matrix[at + 14] = positions[p + 2];
  matrix[at + 15] = 1;
}
