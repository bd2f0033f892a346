// Replays recorded streams to the WebAssembly client, and compares its state with the recorded one, bit for bit.
//
// Usage: node streams.mjs MODULE.wasm [RECORDING.json ...]. Without recordings: the vectors of spec/. A recording has the
// form of spec/vectors/streams.json. Prints failures, then a count; the exit code is 1 after a failure.

import { readFile } from "node:fs/promises";

import { load, Member } from "../rhumb.js";

const [wasm, ...recordings] = process.argv.slice(2);
await load(await readFile(wasm));

const VECTORS = ["streams.json", "scripted.json"].map((name) => new URL(`../../../spec/vectors/${name}`, import.meta.url));

const bytesOf = (digits) => Uint8Array.from(Buffer.from(digits, "hex"));

/** The differences of one stream; `count` counts the compared states. */
function differences({ events }, count) {
  const member = new Member("golden", { join: { mode: "join" } });
  const found = [];
  member.handleOpened(0);
  for (const [place, [kind, value]] of events.entries()) {
    if (kind === "control") member.handleControl(0, bytesOf(value));
    else if (kind === "datagram") member.handleDatagram(0, bytesOf(value));
    else if (kind === "known") {
      // Bodies that came are there once a view has shown them.
      if (member.completeTick !== undefined) member.show(member.completeTick);
      const digest = member.digest ?? {};
      // Scripted streams state more words than a digest has.
      const words = Object.keys(digest).length === 0 ? Object.keys(value) : Object.keys(digest);
      for (const word of words) {
        if (word in value && digest[word] !== value[word]) {
          found.push(`event ${place}: ${word} is ${digest[word]}, but ${value[word]} is expected`);
        }
      }
      count.states += 1;
      if (value.poses !== undefined && digest.poses !== undefined) count.poses += 1;
      else if (value.poses !== undefined) count.without += 1;
    }
  }
  member.free();
  return found;
}

// Of the vectors: a tick before which bodies come or go is not shown yet.
const WITHOUT_POSES_MAX = 89;
const count = { states: 0, poses: 0, without: 0 };
let [passed, failed] = [0, 0];
for (const file of recordings.length > 0 ? recordings : VECTORS) {
  const { streams } = JSON.parse(await readFile(file));
  for (const stream of streams) {
    const found = differences(stream, count);
    if (found.length === 0) passed += 1;
    else {
      failed += 1;
      console.log(`${stream.name}: ${found.slice(0, 3).join("; ")}`);
    }
  }
}
console.log(`${passed} streams passed, ${failed} failed: ${count.states} states, ${count.poses} with the bits of all poses`);
const isCompared = count.poses > 0 && (recordings.length > 0 || count.without <= WITHOUT_POSES_MAX);
if (!isCompared) console.log(`${count.without} states whose poses are known were not compared`);
process.exitCode = failed === 0 && isCompared ? 0 : 1;
