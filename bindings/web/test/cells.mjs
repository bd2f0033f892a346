// A member by cells: what it takes, what is denied, what it knows of the bodies that it shows.
//
// Usage: node cells.mjs MODULE.wasm SOCKET, of a server that divides its scenes into columns of four metres.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";

import { connect, load } from "../rhumb.js";
import { transportTo } from "./unix.mjs";

const [wasm, socket] = process.argv.slice(2);
await load(await readFile(wasm));

async function joined(options) {
  const connection = await connect("https://127.0.0.1:1", { transport: transportTo(socket) });
  const mode = { createOrJoin: { stepping: "lockstep", gravity: [0, 0, 0] } };
  return connection.join("cells", { mode, resumeWithin: 0, ...options });
}

async function arrive(client) {
  while (client.cells.some(({ state }) => state === "awaited")) await client.advance();
}

const owner = await joined({ stream: "full" });
const ball = { kind: "dynamic", shape: { kind: "ball", radius: 0.5 } };
const floor = owner.addBody({ kind: "fixed", shape: { kind: "cuboid", halfExtents: [20, 0.5, 20] }, position: [0, -3, 0] });
const [near, beside, away] = owner.addBodies([[2, 2], [5, 0.6], [90, 2]].map(([x, z]) => ({ ...ball, position: [x, 5, z] })));
const frames = [{ anchor: [0, 0, 0] }, { anchor: [0, 0, 0] }];
owner.command({ kind: "addJoint", id: 7, joint: { kind: "rope", length: 90, bodies: [near, beside], frames } });
await owner.advance();

const walker = await joined({ cells: true });
assert.equal(owner.cellGrid, undefined);
assert.deepEqual(owner.cells, []);
assert.deepEqual(walker.cellGrid, [4, 0, 4]);
assert.deepEqual([...walker.view.ids], [floor]);

const bands = [
  { radius: 1, stream: "full" },
  { radius: 5, stream: { within: 0.02 } },
];
walker.takeCellsAround([2, 0, 2], bands);
await arrive(walker);
assert.deepEqual([...walker.view.ids].sort(), [floor, near, beside].sort());
assert.equal(new Set(walker.view.ids).size, walker.view.count);
assert.ok(walker.errorBound(near) < 0.0011 && walker.errorBound(beside) < 0.0201);
assert.equal(walker.errorBound(away), undefined);
assert.equal(walker.body(near).id, near);
assert.equal(walker.shape(walker.body(near).shape).radius, 0.5);
assert.ok(walker.track(near) !== undefined && walker.track(away) === undefined);
const place = walker.view.place(near);
assert.deepEqual([...walker.view.positions.slice(3 * place, 3 * place + 3)], [2, 5, 2]);
assert.equal(walker.view.shapes[place], walker.body(near).shape);
assert.ok(walker.view.tolerances[walker.view.place(beside)] > 0.019 && walker.view.tolerances[place] === 0);

// A body that goes from cell to cell is the same one.
owner.command({ kind: "setVelocity", id: near, linear: [6, 0, 0], angular: [0, 0, 0] });
owner.flush();
for (let tick = 0; tick < 30; tick += 1) {
  await walker.advance();
  assert.equal(new Set(walker.view.ids).size, walker.view.count);
}
// Both bodies of the joint are in one cell now.
assert.deepEqual(walker.joints().get(7).bodies, [near, beside]);
assert.ok(walker.view.positions[3 * walker.view.place(near)] > 4.5);

walker.takeCells([
  { cell: [22, 0, 0], stream: { within: 0.05 } },
  { cell: [0, 1, 0], stream: "full" },
]);
await arrive(walker);
assert.deepEqual(walker.cells, [
  { cell: [0, 1, 0], state: "denied", denial: "noSuchScene" },
  { cell: [22, 0, 0], state: "shown" },
]);
assert.deepEqual([...walker.view.ids].sort(), [floor, away].sort());

const within = { within: 0.1 };
assert.throws(() => owner.takeCells([]), { code: "notNow", message: /not divided/ });
assert.throws(() => walker.takeCellsAround([0, 0, 0], [{ radius: 500, stream: within }]), { code: "argument" });
assert.throws(() => walker.takeCellsAround([1e30, 0, 0], [{ radius: 1, stream: within }]), { code: "argument" });
assert.throws(() => walker.takeCellsAround([0, 0, 0], [{ radius: -1, stream: within }]), { message: /radius: must be/ });
assert.throws(() => walker.takeCellsAround([0, 0], []), { message: /point: must be/ });
assert.throws(() => walker.takeCells([{ cell: [0, 0], stream: within }]), { message: /cell: must be/ });
assert.throws(() => walker.takeCells([{ cell: [0, 0.5, 0], stream: within }]), { code: "argument" });
assert.throws(() => walker.takeCells([{ cell: [0, 0, 0] }]), { message: /stream: is missing/ });

walker.close();
owner.close();
console.log("the cells around were shown");
