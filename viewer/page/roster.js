// The bodies of a copy: their shapes, kinds and radii. They change seldom, and are copied out of its memory.

import { boundingRadius } from "./shapes.js";

/** Place of bodies that are not in the scene, metres. */
export const AWAY = 1e7;
const STATIC = 0;

/** The bodies of a frame; an object that is never changed. `source` has their shapes. */
export function rosterOf({ generation, count, ids, shapes, kinds }, source) {
  // Asking for a shape ends the columns.
  const own = { generation, count, ids: ids.slice(), shapeNumbers: shapes.slice(), kinds: kinds.slice() };
  const shapesByNumber = new Map(Array.from(new Set(own.shapeNumbers), (shape) => [shape, source.shape(shape)]));
  return layoutOf({ ...own, shapesByNumber });
}

/**
 * Completes what is known of bodies: `radii`, bounding radius of each place, metres; `movable`, places of the bodies that are
 * not static; `places` by id.
 */
export function layoutOf(bodies) {
  const { ids, kinds, shapeNumbers, shapesByNumber } = bodies;
  const radiiByNumber = new Map(Array.from(shapesByNumber, ([shape, of]) => [shape, boundingRadius(of)]));
  return {
    ...bodies,
    radii: Float32Array.from(shapeNumbers, (shape) => radiiByNumber.get(shape)),
    movable: Uint32Array.from(kinds.keys()).filter((place) => kinds[place] !== STATIC),
    places: new Map(Array.from(ids, (id, place) => [id, place])),
  };
}
