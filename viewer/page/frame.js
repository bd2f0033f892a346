// A frame: all bodies at one moment, in parallel arrays, whatever it comes from.

/** Columns of a view that a frame has. */
const COLUMNS = ["ids", "shapes", "kinds", "positions", "rotations", "resting", "changed"];
/** Columns that the client computes when they are read. */
const COMPUTED = ["updateTicks", "errorBounds", "tolerances"];

/**
 * A view's columns at its present moment. They lie in the client's memory and are valid until its next call.
 *
 * A column that is computed may make that memory grow, which detaches the columns read before: then they are read again.
 */
export function frameOf(view, computed = true) {
  const names = computed ? [...COLUMNS, ...COMPUTED] : COLUMNS;
  for (;;) {
    const frame = { time: view.time, generation: view.generation, count: view.count };
    for (const name of names) frame[name] = view[name];
    if (isAttached(frame)) return frame;
  }
}

/** False if the client's memory has grown since the frame was read. */
export function isAttached(frame) {
  return frame.count === 0 || frame.positions.length === 3 * frame.count;
}

/** The place of each body of one frame in another one; -1 for a body that it lacks. */
export function placesIn(frame, other) {
  const places = new Map();
  for (let place = 0; place < other.count; place++) places.set(other.ids[place], place);
  return Int32Array.from(frame.ids, (id) => places.get(id) ?? -1);
}
