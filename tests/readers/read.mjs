// Reads traces and recordings with the MCAP reader of TypeScript, @mcap/core: by their indexes, and as a stream.
//
// Usage: RHUMB_NODE_MODULES=FOLDER node read.mjs COUNTS, the file that read.py wrote.

import { strict as assert } from "node:assert";
import { open, readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { join } from "node:path";

const from = createRequire(join(process.env.RHUMB_NODE_MODULES, "node_modules", "x.js"));
const { McapIndexedReader, McapStreamReader } = from("@mcap/core");
const { loadDecompressHandlers } = from("@mcap/support");

const decompressHandlers = await loadDecompressHandlers();
const { files, cut } = JSON.parse(await readFile(process.argv[2], "utf8"));

/** The messages of each topic, by the indexes. */
async function indexed(path) {
  const file = await open(path);
  const readable = {
    size: async () => BigInt((await file.stat()).size),
    read: async (offset, size) => {
      const buffer = new Uint8Array(Number(size));
      await file.read(buffer, 0, Number(size), Number(offset));
      return buffer;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const counts = {};
  for await (const message of reader.readMessages()) {
    const { topic } = reader.channelsById.get(message.channelId);
    counts[topic] = (counts[topic] ?? 0) + 1;
  }
  await file.close();
  return counts;
}

/** The number of messages from the beginning on. */
async function streamed(path) {
  const reader = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  reader.append(await readFile(path));
  let count = 0;
  for (let record; (record = reader.nextRecord()); ) if (record.type === "Message") count += 1;
  return count;
}

let total = 0;
for (const [path, counts] of Object.entries(files)) {
  assert.deepEqual(await indexed(path), counts, path);
  const count = Object.values(counts).reduce((sum, of) => sum + of, 0);
  assert.equal(await streamed(path), count, path);
  total += count;
}
const [path, count] = cut;
assert.equal(await streamed(path), count, path);
console.log(`ok: ${total} messages of ${Object.keys(files).length} files, ${count} of one without an end`);
