// A member without network: what is absent from its JSON, what its events have, and what it shows after it was freed.
//
// Usage: node member.mjs MODULE.wasm. Plays the bytes of spec/vectors/.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";

import { load, Member } from "../rhumb.js";
import { beginning, bytesOf, message, streams } from "./scripted.mjs";

await load(await readFile(process.argv[2]));

/** `BodyPlaced, flags 0` of control.json with flag 8: a mass of 1 kg, and no moments. */
const MASSIVE = bytesOf(["1d0b02ac0202", "8002", "01", "0000803f00", "0608000000803f00002040000040c000"].join(""));
const MASSIVE_ID = 300 + 2 * 2 ** 32;

function played(events) {
  const member = new Member("golden", { join: { mode: "join" } });
  member.handleOpened(0);
  for (const [kind, value] of events) {
    if (kind === "control") member.handleControl(0, bytesOf(value));
    else if (kind === "datagram") member.handleDatagram(0, bytesOf(value));
  }
  member.show(member.completeTick);
  return member;
}

const joined = () => played(beginning("balls that fall into a pit"));

function eventsOf(member) {
  const events = [];
  for (let event = member.pollEvent(); event !== undefined; event = member.pollEvent()) events.push(event);
  return events;
}

/** The places of fields that are null. A null in a list is documented: an axis without limits or motor. */
function nulls(value, place) {
  if (typeof value !== "object" || value === null) return [];
  return Object.entries(value).flatMap(([name, part]) => {
    if (part !== null) return nulls(part, Array.isArray(value) ? `${place}[]` : `${place}.${name}`);
    return Array.isArray(value) ? [] : [`${place}.${name}`];
  });
}

test("options of a view are refused before there is one", () => {
  const member = new Member("golden", { join: { mode: "join" } });
  for (const set of [() => member.setDelayTicks(3), () => member.setLeadTicks(3), () => member.setSmooth(true)]) {
    assert.throws(set, { code: "notNow" });
  }
});

test("an absent part of the scene is undefined", () => {
  const found = new Set();
  const absent = { parent: 0, acceleration: 0, limits: 0 };
  for (const { events } of streams) {
    const member = played(events);
    const { config, stream } = member;
    const ids = Array.from(member.view.ids);
    const [bodies, tracks] = [ids.map((id) => member.body(id)), ids.map((id) => member.track(id))];
    const joints = Array.from(member.joints().values());
    for (const place of nulls({ config, stream, bodies, tracks, joints }, "member")) found.add(place);
    // A scene always has a rule of sleep.
    assert.notEqual(config.sleep, undefined);
    assert.notEqual(config.sleep, null);
    absent.parent += tracks.filter(({ parent }) => parent == null).length;
    absent.acceleration += tracks.filter(({ acceleration }) => acceleration == null).length;
    absent.limits += joints.filter(({ kind, limits }) => kind === "revolute" && limits == null).length;
    member.free();
  }
  assert.ok(Object.values(absent).every((count) => count > 0), JSON.stringify(absent));
  assert.deepEqual([...found], []);
});

test("the absent moments of a mass are undefined", () => {
  const member = played(streams[0].events);
  member.handleControl(0, MASSIVE);
  assert.deepEqual(member.body(MASSIVE_ID)?.mass, { mass: 1 });
});

test("an absent close code is undefined", () => {
  const member = joined();
  member.handleEnded(0);
  assert.deepEqual(nulls(eventsOf(member), "events"), []);
});

test("each event says what is complete", () => {
  const member = joined();
  const ball = { kind: "dynamic", shape: { kind: "ball", radius: 0.5 } };
  assert.throws(() => member.addBodies(Array(5000).fill(ball)), { code: "noIds" });
  member.handleControl(0, message("Reserved, 4096 from 0"));
  const events = eventsOf(member);
  assert.equal(events.at(-1).kind, "reserved");
  for (const event of events) assert.ok(Number.isInteger(event.complete), JSON.stringify(event));
});

test("a freed member does not show another one", () => {
  const freed = joined();
  const id = freed.view.ids[0];
  assert.ok(freed.view.count > 0 && freed.body(id) !== undefined);
  freed.free();
  const other = joined();
  assert.ok(other.view.positions.length > 0);
  assert.throws(() => freed.view.positions, { code: "notNow" });
  assert.throws(() => freed.view.count, { code: "notNow" });
  assert.throws(() => freed.view.place(id), { code: "notNow" });
  assert.throws(() => freed.body(id), { code: "notNow" });
  assert.throws(() => freed.completeTick, { code: "notNow" });
  freed.free();
  assert.ok(other.view.positions.length > 0);
});
