// Geometries of the protocol's shapes, in the body's frame: its origin is the centre of mass.

import * as THREE from "three";
import { ConvexGeometry } from "three/addons/geometries/ConvexGeometry.js";
import { RoundedBoxGeometry } from "three/addons/geometries/RoundedBoxGeometry.js";
import { mergeGeometries, mergeVertices } from "three/addons/utils/BufferGeometryUtils.js";

/** Half the edge of the part of a half space that is drawn, metres. */
const HALF_SPACE = 250;

/** A geometry of a shape; `detail` is that of round surfaces, 1 or 2. */
export function geometryOf(shape, detail) {
  const around = 8 * detail;
  switch (shape.kind) {
    case "ball":
      return sphere(shape.radius, detail);
    case "cuboid":
      return new THREE.BoxGeometry(...shape.halfExtents.map((half) => 2 * half));
    case "roundedCuboid":
      return new RoundedBoxGeometry(
        ...shape.halfExtents.map((half) => 2 * (half + shape.radius)),
        detail,
        shape.radius,
      );
    case "capsule":
      return new THREE.CapsuleGeometry(shape.radius, 2 * shape.halfHeight, 2 * detail, around);
    case "cylinder":
      return new THREE.CylinderGeometry(shape.radius, shape.radius, 2 * shape.halfHeight, around);
    case "cone":
      // Centred at half its height; the centre of mass is at a quarter of it.
      return new THREE.ConeGeometry(shape.radius, 2 * shape.halfHeight, around).translate(0, shape.halfHeight / 2, 0);
    case "halfSpace":
      return plane(shape.normal);
    case "hull":
      return new ConvexGeometry(vectors(shape.points));
    case "heights":
      return heights(shape);
    case "mesh":
      return mesh(shape.points, shape.triangles);
    case "compound":
      return compound(shape.parts, detail);
    default:
      throw new Error(`the server has a shape that this page cannot draw: ${shape.kind}. Load the page anew.`);
  }
}

/** Distance of the farthest point of a shape from the centre of mass, metres; infinite for a half space. */
export function boundingRadius(shape) {
  switch (shape.kind) {
    case "ball":
      return shape.radius;
    case "cuboid":
      return Math.hypot(...shape.halfExtents);
    case "roundedCuboid":
      return Math.hypot(...shape.halfExtents) + shape.radius;
    case "capsule":
      return shape.halfHeight + shape.radius;
    case "cylinder":
      return Math.hypot(shape.halfHeight, shape.radius);
    case "cone":
      return Math.max(1.5 * shape.halfHeight, Math.hypot(shape.halfHeight / 2, shape.radius));
    case "hull":
    case "mesh":
      return vectors(shape.points).reduce((greatest, point) => Math.max(greatest, point.length()), 0);
    case "compound":
      return Math.max(...shape.parts.map((part) => Math.hypot(...part.position) + boundingRadius(part.shape)));
    default:
      return Infinity;
  }
}

function vectors(numbers) {
  const points = [];
  for (let i = 0; i < numbers.length; i += 3)
    points.push(new THREE.Vector3(numbers[i], numbers[i + 1], numbers[i + 2]));
  return points;
}

/** A ball whose triangles share their vertices: a sixth of those that three.js makes, for thousands of balls. */
function sphere(radius, detail) {
  const apart = new THREE.IcosahedronGeometry(1, detail);
  apart.deleteAttribute("uv");
  const shared = mergeVertices(apart);
  const { array } = shared.getAttribute("position");
  for (let part = 0; part < array.length; part++) array[part] *= radius;
  return shared;
}

function plane(normal) {
  const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3(...normal));
  return new THREE.PlaneGeometry(2 * HALF_SPACE, 2 * HALF_SPACE).applyQuaternion(turn);
}

function mesh(points, triangles) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
  geometry.setIndex([...triangles]);
  const flat = geometry.toNonIndexed();
  flat.computeVertexNormals();
  return flat;
}

function heights({ rows, columns, rowSpacing, columnSpacing, heights }) {
  const points = [];
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      const x = (column - (columns - 1) / 2) * columnSpacing;
      const z = (row - (rows - 1) / 2) * rowSpacing;
      points.push(x, heights[row * columns + column], z);
    }
  }
  const triangles = [];
  for (let row = 0; row + 1 < rows; row++) {
    for (let column = 0; column + 1 < columns; column++) {
      const post = row * columns + column;
      triangles.push(post, post + columns, post + 1, post + 1, post + columns, post + columns + 1);
    }
  }
  return mesh(points, triangles);
}

function compound(parts, detail) {
  const one = new THREE.Vector3(1, 1, 1);
  const geometries = parts.map(({ position, rotation, shape }) => {
    const place = new THREE.Matrix4().compose(new THREE.Vector3(...position), new THREE.Quaternion(...rotation), one);
    const geometry = geometryOf(shape, detail);
    const flat = geometry.index ? geometry.toNonIndexed() : geometry;
    for (const name of Object.keys(flat.attributes)) {
      if (name !== "position" && name !== "normal") flat.deleteAttribute(name);
    }
    return flat.applyMatrix4(place);
  });
  return mergeGeometries(geometries);
}
