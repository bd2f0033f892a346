// Reads a trace of `rhumb-bench evaluate` or `replay` (MCAP): a load's truth, and a client's copy beside it. A recording of a
// server has the truth alone.
//
// `trace/proto/rhumb.proto` describes the messages. Only what the page shows is read.

import { decompress } from "./fzstd/fzstd.js";
import { decompressLz4 } from "./lz4.js";
import { AWAY } from "./roster.js";
import { metres } from "./text.js";

/** The first bytes of a file, and its last ones if it was ended. */
const MAGIC = [0x89, ...new TextEncoder().encode("MCAP0\r\n")];
const OPCODE = { channel: 0x04, message: 0x05, chunk: 0x06, metadata: 0x0c };
const KINDS = [0, 0, 1, 2];
/** Bytes of a chunk, unpacked, at most. */
const UNPACKED_MAX = 2 ** 30;
/** Steps of the grid in a metre, and in a unit of a quaternion's components. */
const STEPS = 2 ** 20;

/**
 * The file of these bytes: its `loads`, each with the `runs` whose copies it has, and `open`, which reads one of them: `bodies`,
 * `ticks` of the truth, and with a copy its ticks as `copy`, and `bytes`, what it received up to each tick.
 */
export function readMcap(bytes) {
  const file = { topics: new Map(), messages: new Map(), metadata: new Map() };
  const isCut = !isEnded(bytes);
  try {
    readRecords(bytes.subarray(MAGIC.length), file);
  } catch (cause) {
    if (cause instanceof RangeError) throw new Error("the MCAP file is damaged");
    throw cause;
  }
  for (const messages of file.messages.values()) inOrder(messages);
  const topics = [...file.messages.keys()];
  const loads = topics
    .filter((topic) => topic.endsWith("/truth/state"))
    .map((topic) => loadOf(topic.slice(0, -"/truth/state".length), topics, file))
    .sort((one, other) => one.order - other.order);
  if (loads.length === 0) {
    throw new Error(
      isCut
        ? "the MCAP file ends within its first chunk, and this page reads whole ones: rhumb-bench replay reads what is there"
        : "the MCAP file has no truth: it is no trace of rhumb-bench and no recording of a server",
    );
  }
  return { loads, open: (load, run) => open({ ...file, isCut }, load, run) };
}

/** A load by the beginning of its topics, with its runs: those over Rhumb first. */
function loadOf(topic, topics, { metadata }) {
  const copies = topics.filter((other) => other.startsWith(`${topic}/`) && other.endsWith("/seen"));
  const runs = copies.map((copy) => copy.slice(topic.length + 1, -"/seen".length));
  runs.sort((one, other) => Number(other.includes("rhumb")) - Number(one.includes("rhumb")));
  const name = topic.slice(1);
  const named = (metadata.get("rhumb.experiment")?.loads ?? "").split(/\s+/).indexOf(name);
  return { name, runs, order: named < 0 ? Infinity : named };
}

function open(file, load, run) {
  const runs = [...file.metadata].filter(([name]) => name.startsWith("rhumb.run.")).map(([, values]) => values);
  const facts =
    runs.find((values) => values.load === load && values.name === run) ??
    runs.find((values) => values.load === load) ??
    [...file.metadata].find(([name, values]) => name.startsWith("rhumb.scene") && values.scene === load)?.[1] ??
    {};
  const messages = (name) => file.messages.get(`/${load}/${name}`)?.map(([, bytes]) => fields(bytes));
  const copy = run && { seen: messages(`${run}/seen`), stats: messages(`${run}/stats`) ?? [] };
  const recording = new Trace(messages("truth/state"), copy, facts, run).recording();
  // Whole chunks are there up to it.
  if (file.isCut) recording.what += "; the file ends early";
  return recording;
}

/** Puts messages of one topic in order of their time; those of one time stay as they are. */
function inOrder(messages) {
  const isSorted = messages.every(([time], at) => at === 0 || messages[at - 1][0] <= time);
  if (!isSorted) messages.sort(([one], [other]) => (one < other ? -1 : one > other ? 1 : 0));
}

function isEnded(bytes) {
  const end = bytes.subarray(MAGIC.length).slice(-MAGIC.length);
  return end.length === MAGIC.length && MAGIC.every((byte, at) => byte === end[at]);
}

/** Reads whole records, up to one that is cut. */
function readRecords(bytes, file) {
  const data = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;
  // The file ends with its magic, which is shorter than a record's head.
  while (at + 9 <= bytes.length) {
    const opcode = data.getUint8(at);
    const length = Number(data.getBigUint64(at + 1, true));
    at += 9;
    if (at + length > bytes.length) return;
    readRecord(opcode, bytes.subarray(at, at + length), file);
    at += length;
  }
}

function readRecord(opcode, bytes, file) {
  const data = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const text = (at) => {
    const length = data.getUint32(at, true);
    return [new TextDecoder().decode(bytes.subarray(at + 4, at + 4 + length)), at + 4 + length];
  };
  if (opcode === OPCODE.channel) {
    file.topics.set(data.getUint16(0, true), text(4)[0]);
  } else if (opcode === OPCODE.message) {
    const topic = file.topics.get(data.getUint16(0, true));
    if (!/\/(state|seen|stats)$/.test(topic)) return;
    if (!file.messages.has(topic)) file.messages.set(topic, []);
    file.messages.get(topic).push([data.getBigUint64(6, true), bytes.subarray(22)]);
  } else if (opcode === OPCODE.metadata) {
    const [name, start] = text(0);
    const end = start + 4 + data.getUint32(start, true);
    const values = {};
    for (let at = start + 4; at < end;) {
      const [key, after] = text(at);
      [values[key], at] = text(after);
    }
    file.metadata.set(name, values);
  } else if (opcode === OPCODE.chunk) {
    const size = Number(data.getBigUint64(16, true));
    const [compression, start] = text(28);
    const records = unpacked(compression, bytes.subarray(start + 8), size);
    // Zero: the writer computed none.
    const stated = data.getUint32(24, true);
    if (stated !== 0 && stated !== checksum(records)) {
      throw new Error("the MCAP file is damaged: the checksum of a chunk differs");
    }
    readRecords(records, file);
  }
}

/** Remainders of each byte for CRC-32, the polynomial of zlib. */
const CRC_REMAINDERS = Uint32Array.from({ length: 256 }, (_, byte) => {
  let remainder = byte;
  for (let bit = 0; bit < 8; bit++) remainder = remainder & 1 ? (remainder >>> 1) ^ 0xedb88320 : remainder >>> 1;
  return remainder;
});

function checksum(bytes) {
  let remainder = 0xffffffff;
  for (const byte of bytes) remainder = (remainder >>> 8) ^ CRC_REMAINDERS[(remainder ^ byte) & 255];
  return (remainder ^ 0xffffffff) >>> 0;
}

/** The records of a chunk. */
function unpacked(compression, packed, size) {
  if (size > UNPACKED_MAX) throw new Error(`a chunk of the MCAP file has ${size} bytes: this page unpacks up to ${UNPACKED_MAX}`);
  switch (compression) {
    case "":
      return packed;
    case "zstd":
      return decompress(packed, new Uint8Array(size));
    case "lz4":
      return decompressLz4(packed, new Uint8Array(size));
    default:
      throw new Error(`the MCAP file is compressed by ${compression}, not by zstd or lz4`);
  }
}

/** A message of protobuf: for each field the values of all its entries; packed numbers as bytes. */
function fields(bytes) {
  const out = new Map();
  const data = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;
  const varint = () => {
    let value = 0;
    for (let scale = 1; ; scale *= 128) {
      const byte = data.getUint8(at++);
      value += (byte & 127) * scale;
      if (byte < 128) return value;
    }
  };
  while (at < bytes.length) {
    const key = varint();
    let value;
    if (key % 8 === 0) value = varint();
    else if (key % 8 === 1) value = data.getFloat64((at += 8) - 8, true);
    else if (key % 8 === 5) value = data.getFloat32((at += 4) - 4, true);
    else {
      const length = varint();
      value = bytes.subarray(at, at + length);
      at += length;
    }
    const number = Math.floor(key / 8);
    if (!out.has(number)) out.set(number, []);
    out.get(number).push(value);
  }
  return out;
}

/** Packed varints. */
function varints(message, field) {
  const numbers = [];
  for (const bytes of message.get(field) ?? []) {
    if (typeof bytes === "number") numbers.push(bytes);
    else {
      let value = 0,
        scale = 1;
      for (const byte of bytes) {
        value += (byte & 127) * scale;
        scale *= 128;
        if (byte < 128) {
          numbers.push(value);
          value = 0;
          scale = 1;
        }
      }
    }
  }
  return numbers;
}

/** Packed signed varints. */
function signed(message, field) {
  return varints(message, field).map((number) => (number % 2 === 0 ? number / 2 : -(number + 1) / 2));
}

/** Poses on the grid: second differences of whole steps, body by body. */
class Grid {
  #history = new Map();

  forget(body) {
    this.#history.delete(body);
  }

  decode(body, residual) {
    const [last, before] = this.#history.get(body) ?? [];
    const now = last === undefined ? residual : residual.map((step, part) => step + 2 * last[part] - before[part]);
    this.#history.set(body, [now, last ?? now]);
    return now.map((steps) => steps / STEPS);
  }
}

/** A pose that differs from the truth's by whole steps. */
function beside(truth, residual) {
  if (residual.every((step) => step === 0)) return truth;
  return residual.map((step, part) => (Math.floor(truth[part] * STEPS + 0.5) + step) / STEPS);
}

/** Packed 32-bit floats. */
function floats(message, field) {
  return (message.get(field) ?? []).flatMap((bytes) => {
    if (typeof bytes === "number") return [bytes];
    const data = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    return Array.from({ length: bytes.length / 4 }, (_, at) => data.getFloat32(4 * at, true));
  });
}

function shapeOf(number, extents) {
  switch (number) {
    case 1:
      return { kind: "ball", radius: extents[0] };
    case 2:
      return { kind: "cuboid", halfExtents: extents };
    case 3:
      return { kind: "capsule", halfHeight: extents[0], radius: extents[1] };
    case 4:
      return { kind: "cylinder", halfHeight: extents[0], radius: extents[1] };
    case 5:
      return { kind: "hull", points: extents };
    case 6:
      return { kind: "roundedCuboid", halfExtents: extents.slice(0, 3), radius: extents[3] };
    case 7:
      return { kind: "cone", halfHeight: extents[0], radius: extents[1] };
    case 8:
      return { kind: "halfSpace", normal: extents };
    case 0:
      // A height field, mesh or compound, whose measures the states do not have: a point.
      return { kind: "ball", radius: 0 };
    default:
      throw new Error(`the trace has a shape that this page does not know: ${number}`);
  }
}

class Trace {
  #bodies = [];
  #places = new Map();
  #truth;
  #copy;
  #facts;
  #run;
  #grid = new Grid();
  #truthGrid = new Grid();

  constructor(truth, copy, facts, run) {
    this.#truth = truth;
    this.#copy = copy;
    this.#facts = facts;
    this.#run = run;
  }

  /** The truth's ticks, and those of the copy if there is one. */
  recording() {
    const step = Number(this.#facts.step_s ?? 1 / 60);
    const ticks = this.#truth.map((message) => this.#states(message));
    const copy = this.#copy && this.#copied(ticks);
    const bytes = this.#copy && this.#received(ticks.length);
    const tolerance = this.#copy && Number(this.#facts.tolerance_m ?? NaN);
    const count = this.#bodies.length;
    const within = tolerance > 0 ? `, within ${metres(tolerance)}` : "";
    const what = this.#copy === undefined ? "the truth" : `the copy of ${this.#run}${within}`;
    const title = `${count === 1 ? "1 body" : `${count} bodies`}, ${what}`;
    return { bodies: this.#bodies, ticks, copy, bytes, step, tolerance, what: title };
  }

  /** Bytes that the copy had received when each tick was shown. */
  #received(count) {
    const bytes = new Float64Array(count);
    for (const message of this.#copy.stats) {
      const tick = message.get(1)?.[0] ?? 0;
      if (tick < count) bytes[tick] += message.get(8)?.[0] ?? 0;
    }
    for (let tick = 1; tick < count; tick++) bytes[tick] += bytes[tick - 1];
    return bytes;
  }

  #place(index, generation) {
    return this.#places.get(index + generation * 2 ** 32);
  }

  /** A tick of the truth: what was observed, and what was placed after it. */
  #states(message) {
    const indices = varints(message, 2);
    const generations = varints(message, 3);
    const awake = varints(message, 17);
    const isExact = indices.length === 0 || message.has(4);
    const columns = Array.from({ length: 7 }, (_, part) => (isExact ? floats(message, 4 + part) : signed(message, 21 + part)));
    const tick = { places: [], positions: [], rotations: [], resting: [] };
    indices.forEach((index, at) => {
      const body = index + generations[at] * 2 ** 32;
      const values = columns.map((column) => column[at]);
      if (isExact) this.#truthGrid.forget(body);
      const pose = isExact ? values : this.#truthGrid.decode(body, values);
      const place = this.#places.get(body);
      if (place === undefined) return;
      tick.places.push(place);
      tick.positions.push(...pose.slice(0, 3));
      tick.rotations.push(...pose.slice(3));
      tick.resting.push(1 - awake[at]);
    });
    tick.removed = this.#removed(message, 19);
    const placed = (message.get(18) ?? []).map(fields).map((placement) => this.#add(placement));
    return append(tick, placed);
  }

  #add(placement) {
    const number = (field) => placement.get(field)?.[0] ?? 0;
    const place = this.#bodies.length;
    this.#places.set(number(1) + number(2) * 2 ** 32, place);
    const motion = floats(placement, 7);
    const body = { kind: KINDS[number(3)], shape: shapeOf(number(4), floats(placement, 5)) };
    this.#bodies.push(body);
    return { place, position: motion.slice(0, 3), rotation: motion.slice(3, 7), resting: 1 - number(8) };
  }

  /** Adds what a message of the copy changes. */
  #show(message, truth, shown) {
    const generations = varints(message, 4);
    const resting = varints(message, 12);
    const exact = Array.from({ length: 7 }, (_, part) => floats(message, 5 + part));
    const steps = Array.from({ length: 7 }, (_, part) => signed(message, 15 + part));
    const isFromTruth = message.get(22)?.[0] === 1;
    varints(message, 3).forEach((index, at) => {
      const body = index + generations[at] * 2 ** 32;
      const place = this.#places.get(body);
      let pose;
      if (exact[0].length > 0) {
        pose = exact.map((column) => column[at]);
        this.#grid.forget(body);
      } else {
        const residual = steps.map((column) => column[at]);
        const real = () => [
          ...truth.positions.subarray(3 * place, 3 * place + 3),
          ...truth.rotations.subarray(4 * place, 4 * place + 4),
        ];
        if (isFromTruth && place === undefined) return;
        pose = isFromTruth ? beside(real(), residual) : this.#grid.decode(body, residual);
      }
      if (place === undefined) return;
      shown.places.push(place);
      shown.positions.push(...pose.slice(0, 3));
      shown.rotations.push(...pose.slice(3));
      shown.resting.push(resting[at]);
    });
    shown.removed.push(...this.#removed(message, 13));
  }

  #removed(message, first) {
    const generations = varints(message, first + 1);
    const places = varints(message, first).map((index, at) => this.#place(index, generations[at]));
    return places.filter((place) => place !== undefined);
  }

  /** The copy at each tick. */
  #copied(ticks) {
    const count = this.#bodies.length;
    const truth = { positions: new Float32Array(3 * count).fill(AWAY), rotations: new Float32Array(4 * count) };
    const seen = new Map();
    for (const message of this.#copy.seen) {
      const tick = message.get(1)?.[0] ?? 0;
      if (!seen.has(tick)) seen.set(tick, []);
      seen.get(tick).push(message);
    }
    const isThere = new Uint8Array(count);
    return ticks.map((tick, number) => {
      put(truth, tick);
      const shown = { places: [], positions: [], rotations: [], resting: [], removed: [] };
      for (const message of seen.get(number) ?? []) this.#show(message, truth, shown);
      // Bodies that were placed and that the copy has not mentioned stand at their placement.
      const mentioned = new Set(shown.places);
      const placed = Array.from(tick.places).filter((place) => isThere[place] === 0 && !mentioned.has(place));
      const whole = append(
        shown,
        placed.map((place) => ({
          place,
          position: truth.positions.slice(3 * place, 3 * place + 3),
          rotation: truth.rotations.slice(4 * place, 4 * place + 4),
          resting: 0,
        })),
      );
      for (const place of whole.places) isThere[place] = 1;
      return whole;
    });
  }
}

/** A tick with more bodies at its end. */
function append(tick, bodies) {
  return {
    places: Uint32Array.from([...tick.places, ...bodies.map(({ place }) => place)]),
    positions: Float32Array.from([...tick.positions, ...bodies.flatMap(({ position }) => [...position])]),
    rotations: Float32Array.from([...tick.rotations, ...bodies.flatMap(({ rotation }) => [...rotation])]),
    resting: Uint8Array.from([...tick.resting, ...bodies.map(({ resting }) => resting)]),
    removed: tick.removed,
  };
}

function put(columns, { places, positions, rotations }) {
  places.forEach((place, at) => {
    columns.positions.set(positions.subarray(3 * at, 3 * at + 3), 3 * place);
    columns.rotations.set(rotations.subarray(4 * at, 4 * at + 4), 4 * place);
  });
}
