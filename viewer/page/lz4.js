// Unpacks LZ4 frames, as other writers of MCAP files pack their chunks.

const MAGIC = 0x184d2204;
/** Bits of the frame's flags: what its head and its blocks have. */
const DICTIONARY = 1;
const CONTENT_SIZE = 8;
const BLOCK_CHECKSUMS = 16;
/** A block whose size has this bit is not packed. */
const PLAIN = 2 ** 31;
/** A match is at least so long, bytes. */
const MATCH_MIN = 4;

/** Unpacks a frame into `out`, which it fills; throws a RangeError for what is no such frame. Its checksums are not compared. */
export function decompressLz4(bytes, out) {
  const data = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (data.getUint32(0, true) !== MAGIC) throw new RangeError("no LZ4 frame");
  const flags = data.getUint8(4);
  // Flags, the size of a block, what the flags say, and a checksum of these.
  let at = 7 + (flags & CONTENT_SIZE ? 8 : 0) + (flags & DICTIONARY ? 4 : 0);
  let to = 0;
  for (;;) {
    const size = data.getUint32(at, true);
    at += 4;
    if (size === 0) break;
    const end = at + (size % PLAIN);
    if (end > bytes.length) throw new RangeError("a block ends too early");
    if (size >= PLAIN) {
      out.set(bytes.subarray(at, end), to);
      to += end - at;
    } else {
      to = unpackBlock(bytes, at, end, out, to);
    }
    at = end + (flags & BLOCK_CHECKSUMS ? 4 : 0);
  }
  if (to !== out.length) throw new RangeError("the frame has another size");
  return out;
}

/** Unpacks the block from `at` to `end` behind `to`; returns where it ends in `out`. */
function unpackBlock(bytes, at, end, out, to) {
  const length = (short) => {
    let sum = short;
    if (short < 15) return sum;
    for (;;) {
      const more = at < end ? bytes[at++] : 0;
      sum += more;
      if (more < 255) return sum;
    }
  };
  while (at < end) {
    const token = bytes[at++];
    const literals = length(token >> 4);
    if (at + literals > end || to + literals > out.length) throw new RangeError("literals end too late");
    out.set(bytes.subarray(at, at + literals), to);
    at += literals;
    to += literals;
    // The last sequence has literals alone.
    if (at >= end) return to;
    const offset = bytes[at] + 256 * (bytes[at + 1] ?? 0);
    at += 2;
    const match = MATCH_MIN + length(token & 15);
    if (offset === 0 || offset > to || to + match > out.length) throw new RangeError("a match lies outside");
    // A match may overlap what it writes.
    for (let copied = 0; copied < match; copied++, to++) out[to] = out[to - offset];
  }
  return to;
}
