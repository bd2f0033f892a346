// Reads an .rhtrace: boxes recorded from another engine. `benches/src/recording/rhtrace.rs` describes the form.

const DYNAMIC = 1;
const MAGIC_BYTES = 8;
/** Bytes of a record: the body, thirteen numbers, and the flags. */
const RECORD_BYTES = 2 + 13 * 4 + 1;

/** The recording of unpacked bytes. */
export function readRhtrace(bytes) {
  const data = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  try {
    return read(data);
  } catch (cause) {
    if (cause instanceof RangeError) throw new Error("the .rhtrace ends too early");
    throw cause;
  }
}

function read(data) {
  let at = MAGIC_BYTES;
  const u16 = () => data.getUint16((at += 2) - 2, true);
  const u32 = () => data.getUint32((at += 4) - 4, true);
  const f32 = () => data.getFloat32((at += 4) - 4, true);
  const count = u32();
  const frames = u32();
  const step = f32();
  const gravity = [f32(), f32(), f32()];
  if (!(step > 0 && step <= 1)) throw new Error("the .rhtrace has no valid step");
  const bodies = [];
  for (let body = 0; body < count; body++) {
    bodies.push({ kind: DYNAMIC, shape: { kind: "cuboid", halfExtents: [f32(), f32(), f32()] } });
    at += 4;
  }
  const ticks = [];
  let before = [];
  for (let frame = 0; frame < frames; frame++) {
    const records = u16();
    if (at + records * RECORD_BYTES > data.byteLength) throw new Error("the .rhtrace ends too early");
    const places = new Uint32Array(records);
    const positions = new Float32Array(3 * records);
    const rotations = new Float32Array(4 * records);
    for (let record = 0; record < records; record++) {
      places[record] = u16();
      if (places[record] >= count) throw new Error(`frame ${frame} names a body that the .rhtrace does not have`);
      for (let part = 0; part < 3; part++) positions[3 * record + part] = f32();
      for (let part = 0; part < 4; part++) rotations[4 * record + part] = f32();
      at += 6 * 4 + 1;
    }
    ticks.push({ places, positions, rotations, resting: new Uint8Array(records), removed: [] });
    // A body without a record has not changed: it rests.
    const moves = new Set(places);
    ticks[frame].rested = before.filter((place) => !moves.has(place));
    before = Array.from(places);
  }
  if (ticks.length === 0) throw new Error("the .rhtrace has no frame");
  return { bodies, ticks, step, gravity, what: `${count} boxes, ${frames} frames` };
}
