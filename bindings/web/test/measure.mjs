// Measures a build of the client on a recorded session: decoding, and views. Prints figures, asserts none.
//
// Usage: node measure.mjs FOLDER RECORDING.json [RUNS]. The folder has rhumb.js and rhumb.wasm; a recording has the form of
// spec/vectors/streams.json, as `rhumb-follow --record` writes it. Prints the run with the median time of decoding, as JSON.

import { readFile } from "node:fs/promises";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [folder, recording, runs = "5"] = process.argv.slice(2);
if (recording === undefined) {
  console.error("usage: node measure.mjs FOLDER RECORDING.json [RUNS]");
  process.exit(2);
}
const { load, Member } = await import(pathToFileURL(resolve(folder, "rhumb.js")));
await load(await readFile(resolve(folder, "rhumb.wasm")));
const { streams } = JSON.parse(await readFile(recording));
const received = streams[0].events
  .filter(([kind]) => kind !== "known")
  .map(([kind, digits]) => [kind, Uint8Array.from(Buffer.from(digits, "hex"))]);

/** Milliseconds of all datagrams of a session, and of a view of each complete tick. */
function replay() {
  const member = new Member("golden", { join: { mode: "join" } });
  let [decode, view, views, datagrams, shown] = [0, 0, 0, 0, undefined];
  member.handleOpened(0);
  for (const [kind, bytes] of received) {
    const begun = performance.now();
    if (kind === "control") member.handleControl(0, bytes);
    else {
      member.handleDatagram(0, bytes);
      decode += performance.now() - begun;
      datagrams += 1;
    }
    const tick = member.completeTick;
    if (tick === undefined || tick === shown) continue;
    shown = tick;
    const asked = performance.now();
    member.show(tick);
    view += performance.now() - asked;
    views += 1;
  }
  const bodies = member.view.count;
  member.free();
  return { bodies, datagrams, decode_ms: decode, views, view_ms: view / views };
}

const all = Array.from({ length: Number(runs) }, replay).sort((a, b) => a.decode_ms - b.decode_ms);
console.log(JSON.stringify(all[all.length >> 1]));
