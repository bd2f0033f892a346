// Random calls of a client; writes the poses that are shown, with their bounds.
//
// Usage: node shown.mjs MODULE.wasm SOCKET SCENE SEED CALLS STEPPING EXTENT. Each line: tick, fraction, body, position, rotation, bound.
// The same in Python, C and C#; the tests of the workspace compare the lines with the server's truth.

import { readFile } from "node:fs/promises";

import { connect, load } from "../rhumb.js";
import { transportTo } from "./unix.mjs";

const [wasm, socket, scene, seed, calls, stepping, extent] = process.argv.slice(2);
const cells = extent === "cells";
const isFree = stepping === "free running";
await load(await readFile(wasm));

let state = BigInt(seed);

/** The generator of all languages: Knuth's, its upper 31 bits. */
function pick(count) {
  state = BigInt.asUintN(64, state * 6364136223846793005n + 1442695040888963407n);
  return Number((state >> 33n) % BigInt(count));
}

const real = (least, most) => least + ((most - least) * pick(1_000_000)) / 1e6;
const pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

const options = { delayTicks: pick(4) * 3, smooth: pick(2) === 1, wholeTicks: pick(2) === 1, cells, resumeWithin: 0 };
const config = { stepping: isFree ? "freeRunning" : "lockstep" };
const connection = await connect("https://127.0.0.1:1", { transport: transportTo(socket) });
const client = await connection.join(scene, { ...options, mode: { createOrJoin: config } });
client.addBody({ kind: "fixed", shape: { kind: "cuboid", halfExtents: [20, 0.5, 20] }, position: [0, -0.5, 0] });

const lines = [];
const bodies = [];

function show() {
  const { count, time } = client.view;
  // Each array is read, and copied, by itself: a later one may move the module's memory.
  const bounds = [...client.view.errorBounds];
  const [ids, positions, rotations] = [[...client.view.ids], [...client.view.positions], [...client.view.rotations]];
  const tick = Math.floor(time);
  for (let place = 0; place < count; place += 1) {
    const id = ids[place];
    // The word of a body in other languages.
    const word = (BigInt(Math.floor(id / 2 ** 32)) << 33n) | BigInt((id % 2 ** 32) + 1);
    const numbers = [...positions.slice(3 * place, 3 * place + 3), ...rotations.slice(4 * place, 4 * place + 4)];
    const bound = bounds[place] === Infinity ? "inf" : bounds[place];
    lines.push([tick, time - tick, word, ...numbers, bound].join(" "));
  }
}

function add() {
  const shape = pick(2) ? { kind: "ball", radius: 0.5 } : { kind: "cuboid", halfExtents: [0.5, 0.5, 0.5] };
  const position = [real(-4, 4), real(1, 8), real(-4, 4)];
  bodies.push(client.addBody({ kind: pick(5) === 0 ? "kinematic" : "dynamic", shape, position }));
}

async function call() {
  const choice = pick(8);
  if (bodies.length === 0 || (choice === 0 && bodies.length < 12)) return add();
  const place = pick(bodies.length);
  const id = bodies[place];
  const [x, y, z] = [real(-6, 6), real(0, 6), real(-6, 6)];
  if (choice === 1 && bodies.length > 4) {
    bodies.splice(place, 1);
    client.command({ kind: "removeBody", id });
  } else if (choice === 2) {
    client.command({ kind: "setPose", id, position: [x, 1 + y, z], rotation: [0, 0, 0, 1] });
  } else if (choice === 3) {
    client.command({ kind: "setVelocity", id, linear: [x, y, z], angular: [0, x, 0] });
  } else if (choice === 4) {
    client.flush();
  } else if (choice === 5) {
    await pause(pick(20));
  }
}

function takeCells() {
  const point = [real(-6, 6), 0, real(-6, 6)];
  const [exact, near, far] = ["full", { within: 0.01 }, { within: 0.2 }];
  const bands = [{ radius: 1, stream: exact }, { radius: 3, stream: near }, { radius: pick(8), stream: far }];
  client.takeCellsAround(point, bands);
}

async function step() {
  if (isFree) {
    await pause(pick(12));
    client.poll();
  } else if (pick(4) === 0) {
    client.poll();
  } else {
    await client.advance();
  }
}

for (let left = Number(calls); left > 0; left -= 1) {
  await call();
  if (cells && pick(8) === 0) takeCells();
  await step();
  show();
}
await pause(100);
client.close();
process.stdout.write(`${lines.join("\n")}\n`);
