// The script that every language runs; it prints the hash of all poses.
//
// Usage: node script.mjs MODULE.wasm SOCKET. tests/tests/processes/bindings/script.rs is the same script in Rust.

import { readFile } from "node:fs/promises";

import { connect, load } from "../rhumb.js";
import { transportTo } from "./unix.mjs";

const PILED = 60;
const TICKS = 150;
const HINGE = 7;

const [wasm, socket] = process.argv.slice(2);
await load(await readFile(wasm));

/** FNV-1a of 64 bits. */
function fold(hash, numbers) {
  for (const byte of new Uint8Array(Float32Array.from(numbers).buffer)) {
    hash = BigInt.asUintN(64, (hash ^ BigInt(byte)) * 0x100000001b3n);
  }
  return hash;
}

const SHAPES = [
  { kind: "ball", radius: 0.25 },
  { kind: "cuboid", halfExtents: [0.5, 0.25, 0.5] },
  { kind: "capsule", halfHeight: 0.5, radius: 0.25 },
  { kind: "cylinder", halfHeight: 0.5, radius: 0.25 },
  { kind: "cone", halfHeight: 0.5, radius: 0.25 },
];

const cuboid = (x, y, z) => ({ kind: "cuboid", halfExtents: [x, y, z] });

function piled(i) {
  const place = (i) => (i % 2) * 1.25 - 0.625;
  const position = [place(i), 1 + 1.5 * Math.floor(i / 4), place(Math.floor(i / 2))];
  return { kind: "dynamic", shape: SHAPES[i % 5], position, angularVelocity: [0, 0.5 * (i % 3), 0] };
}

/** A compound; an anchor, and an arm that hangs on it by a hinge; a walker; a car. */
function built() {
  const ball = { kind: "ball", radius: 0.25 };
  const parts = [
    { position: [-0.5, 0, 0], rotation: [0, 0, 0, 1], shape: ball },
    { position: [0.5, 0, 0], rotation: [0, 0, 0, 1], shape: ball },
    { position: [0, 0, 0.25], rotation: [0.5, 0.5, 0.5, 0.5], shape: cuboid(0.125, 0.5, 0.25) },
  ];
  return [
    { kind: "dynamic", shape: { kind: "compound", parts }, position: [-4, 2, 0] },
    { kind: "fixed", shape: cuboid(0.25, 0.25, 0.25), position: [4, 4, 0] },
    { kind: "dynamic", shape: cuboid(0.25, 1, 0.25), position: [4, 2.5, 0] },
    { kind: "kinematic", shape: { kind: "capsule", halfHeight: 0.5, radius: 0.25 }, position: [7, 1, 3] },
    { kind: "dynamic", shape: cuboid(0.75, 0.25, 1.5), position: [-7, 1, 5] },
  ];
}

function hinge(bodies, motor) {
  return {
    kind: "revolute",
    bodies: [bodies[PILED + 2], bodies[PILED + 3]],
    frames: [{ anchor: [0, -0.5, 0] }, { anchor: [0, 1, 0] }],
    limits: { least: -0.5, most: 1 },
    motors: [null, null, null, { position: 0, velocity: 0, stiffness: 0, damping: 0, force: 1e9, ...motor }, null, null],
  };
}

/** Lets the walker walk and the car roll. */
function setMoving(client, walker, car) {
  client.command({ kind: "setCharacter", id: walker, character: { step: { height: 0.5, width: 0.125 } } });
  client.command({ kind: "setVelocity", id: walker, linear: [-1, 0, -0.5] });
  const places = [-1.25, 1.25].flatMap((z) => [-0.75, 0.75].map((x) => [x, -0.125, z]));
  client.command({ kind: "setVehicle", id: car, wheels: places.map((position) => ({ position, radius: 0.25 })) });
}

function interfere(client, tick, bodies) {
  if (tick === 20) {
    const [front, rear] = [{ steering: 0.25 }, { force: 2000 }];
    client.command({ kind: "setWheels", id: bodies[PILED + 5], inputs: [front, front, rear, rear] });
  } else if (tick === 30) {
    client.command({ kind: "impulse", id: bodies[1], impulse: [200, 100, 0] });
    client.command({ kind: "setVelocity", id: bodies[6], linear: [0, 4, 1], angular: [1, 0, 0] });
  } else if (tick === 40) {
    client.command({ kind: "jump", id: bodies[PILED + 4], speed: 4 });
  } else if (tick === 60) {
    client.command({ kind: "removeBody", id: bodies[4] });
  } else if (tick === 75) {
    client.command({ kind: "changeJoint", id: HINGE, joint: hinge(bodies, { position: 0.75, stiffness: 30, damping: 5 }) });
  } else if (tick === 90) {
    client.command({ kind: "setGravity", gravity: [1, -9.75, 0] });
  }
}

/** The answer to queries. */
async function answered(client, queries) {
  const number = client.query(queries);
  for (;;) {
    for (let event = client.pollEvent(); event !== undefined; event = client.pollEvent()) {
      if (event.kind === "queryResult" && event.number === number) return event.answers;
    }
    await new Promise((resolve) => setTimeout(resolve, 1));
  }
}

const connection = await connect("https://127.0.0.1:1", { transport: transportTo(socket) });
const client = await connection.join("script", { mode: { create: {} }, resumeWithin: 0 });
const floor = { kind: "fixed", shape: cuboid(10, 0.5, 10), position: [0, -0.5, 0] };
const bodies = client.addBodies([floor, ...Array.from({ length: PILED }, (_, i) => piled(i)), ...built()]);
client.command({ kind: "addJoint", id: HINGE, joint: hinge(bodies, { velocity: 1, damping: 4, force: 2000 }) });
setMoving(client, bodies[PILED + 4], bodies[PILED + 5]);
for (let tick = 0; tick < TICKS; tick += 1) {
  interfere(client, tick, bodies);
  await client.advance();
}
let hash = 0xcbf29ce484222325n;
for (const body of bodies) {
  const place = client.view.place(body);
  if (place === undefined) continue;
  hash = fold(hash, client.view.positions.slice(3 * place, 3 * place + 3));
  hash = fold(hash, client.view.rotations.slice(4 * place, 4 * place + 4));
}
const { count } = client.view;
const [hits] = await answered(client, [{ kind: "ray", origin: [-0.625, 50, -0.625], translation: [0, -100, 0], hits: 8 }]);
hash = fold(hash, hits.map(({ distance }) => distance));
console.log(`${count} bodies, ${hits.length} hits, hash ${hash.toString(16).padStart(16, "0")}`);
await client.delete();
