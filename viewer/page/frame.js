// A frame: all bodies at one moment, in parallel arrays, whatever it comes from.

/** Columns of a view that a frame has. */
const COLUMNS = ["ids", "shapes", "kinds", "positions", "rotations", "resting", "changed"];

/**
 * A view's columns at its present moment. They lie in the client's memory and are valid until its next call. `computed`: columns
 * beside those of every frame, which the client computes when they are read (`updateTicks`, `errorBounds`, `tolerances`).
 *
 * A column that is computed may make that memory grow, which detaches the columns read before: then they are read again.
 */
export function frameOf(view, computed = []) {
  const names = [...COLUMNS, ...computed];
  for (;;) {
    const frame = { time: view.time, generation: view.generation, count: view.count };
    for (const name of names) frame[name] = view[name];
    // A detached array is empty.
    if (frame.count === 0 || frame.positions.length === 3 * frame.count) return frame;
  }
}
