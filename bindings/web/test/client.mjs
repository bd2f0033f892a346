// A client over a server that plays recorded bytes, in Node: how its calls end, and what its worker sends.
//
// Usage: node client.mjs MODULE.wasm. Plays the bytes of spec/vectors/.

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { afterEach, test } from "node:test";

import { connect, load } from "../rhumb.js";
import { beginning, message, ScriptedTransport } from "./scripted.mjs";

await load(await readFile(process.argv[2]));

const BEGINNING = beginning("balls that fall into a pit");
/** The datagrams of the first tick, from which on the bodies are there. One that comes before a member has joined is lost. */
const FIRST_TICK = BEGINNING.filter(([kind]) => kind === "datagram");
const URL = "https://127.0.0.1:4433";

/** The servers of the connections that were opened, oldest first. */
const servers = [];

class Transport extends ScriptedTransport {
  constructor(url, { serverCertificateHashes = [] } = {}) {
    super();
    Object.assign(this, { url, hashes: serverCertificateHashes.map(({ value }) => Buffer.from(value).toString("hex")) });
    servers.push(this);
  }
}

const clients = [];
// The timers of a client keep Node from ending.
afterEach(() => clients.splice(0).forEach((client) => client.close()));

/** A member of a lockstep scene, and its server. */
async function joined(options) {
  const connection = await connect(URL, { transport: Transport });
  const server = servers.at(-1);
  const joining = connection.join("golden", { resumeWithin: 0, ...options });
  server.play(BEGINNING);
  const client = await joining;
  clients.push(client);
  return { client, server };
}

/** The client of a member that shows the first tick. */
async function showing() {
  const { client, server } = await joined();
  server.play(FIRST_TICK);
  await until(() => client.completeTick >= 1, "the first tick");
  client.poll();
  return client;
}

const pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

/** Waits for a condition, for two seconds at least. */
async function until(condition, name) {
  for (let tries = 0; tries < 2_000; tries += 1) {
    if (await condition()) return;
    await pause(1);
  }
  assert.fail(`${name} does not come`);
}

/** The value of a promise, or its error; neither if it does not settle within a second. */
async function settled(promise) {
  const result = {};
  const settling = promise.then(
    (value) => (result.value = value),
    (error) => (result.error = error),
  );
  await Promise.race([settling, pause(1000)]);
  return result;
}

function eventKinds(client) {
  const kinds = [];
  for (let event = client.pollEvent(); event !== undefined; event = client.pollEvent()) kinds.push(event.kind);
  return kinds;
}

test("a deleted scene rejects what its members wait for", async () => {
  const [first, second] = [await joined(), await joined()];
  const [advanced, inspected] = [first.client.advance(), first.client.inspect()];
  const deleted = second.client.delete();
  for (const { server } of [first, second]) server.sendControl(message("Deleted"));
  assert.equal((await settled(advanced)).error?.code, "sceneDeleted");
  assert.equal((await settled(inspected)).error?.code, "sceneDeleted");
  assert.ok("value" in (await settled(deleted)));
  for (const { client, server } of [first, second]) {
    assert.equal((await settled(client.closed)).value?.code, "sceneDeleted");
    assert.equal(client.state, "ended");
    assert.equal(client.ending.code, "sceneDeleted");
    assert.deepEqual(eventKinds(client).slice(-2), ["deleted", "ended"]);
    assert.equal((await settled(client.advance())).error?.code, "sceneDeleted");
    assert.throws(() => client.command({ kind: "setGravity", gravity: [0, 0, 0] }), { code: "sceneDeleted" });
    assert.equal((await settled(server.closed)).value?.closeCode, 0);
  }
});

test("a fault of the engine rejects each advance, and nothing else", async () => {
  const { client, server } = await joined();
  const [advanced, inspected] = [client.advance(), client.inspect()];
  server.sendControl(message("SceneFaulted, 0"));
  const { error } = await settled(advanced);
  assert.equal(error?.code, "sceneFaulted");
  assert.match(error.message, /300/);
  assert.equal((await settled(client.advance())).error?.code, "sceneFaulted");
  assert.equal(client.state, "open");
  assert.ok(eventKinds(client).includes("sceneFaulted"));
  const deleted = client.delete();
  server.sendControl(message("Deleted"));
  assert.ok("value" in (await settled(deleted)));
  assert.equal((await settled(inspected)).error?.code, "sceneDeleted");
});

test("a denied stream fails no step, and a denied step no deletion", async () => {
  const { client, server } = await joined();
  const advanced = client.advance();
  server.sendControl(message("Denied, 6"));
  assert.deepEqual(await settled(advanced), {});
  server.sendControl(message("Denied, 9"));
  assert.equal((await settled(advanced)).error?.denial, "tooFarAhead");
  const deleted = client.delete();
  server.sendControl(message("Denied, 9"));
  assert.deepEqual(await settled(deleted), {});
  server.sendControl(message("Denied, 16"));
  assert.equal((await settled(deleted)).error?.denial, "notAllowed");
});

test("what the server refuses is thrown by the next poll, and the one after continues", async () => {
  const { client, server } = await joined();
  assert.equal(client.command({ kind: "removeBody", id: 77 }), 0);
  client.flush();
  server.sendControl(message("Refused, 2 of a body"));
  await pause(10);
  let refused;
  assert.throws(
    () => client.poll(),
    (error) => (refused = error).code === "refused",
  );
  const [{ number, body, reason, message: text }] = refused.refusals;
  assert.equal(refused.refusals.length, 1);
  assert.equal(reason, "unknown body");
  assert.equal(number, 4);
  assert.equal(body, 2 * 2 ** 32 + 300);
  assert.equal(text, `the scene has no body ${body}`);
  assert.ok(refused.message.includes(text));
  client.poll();
  assert.ok(eventKinds(client).includes("refused"));
});

test("refusals that no call throws are kept up to a number and counted", async () => {
  const { client, server } = await joined();
  for (let sent = 0; sent < 1500; sent += 1) server.sendControl(message("Refused, 2 of a body"));
  await pause(50);
  let refused;
  assert.throws(
    () => client.poll(),
    (error) => (refused = error).code === "refused",
  );
  assert.deepEqual([refused.refusals.length, refused.refusalsLeftOut], [1024, 476]);
  assert.match(refused.message, /and 1499 more refusals/);
  client.poll();
});

test("events that nothing reads are dropped from the oldest on and counted", async () => {
  const { client, server } = await joined({ refusals: "events" });
  while (client.pollEvent() !== undefined);
  const one = message("Refused, 2 of a body");
  const count = 65536 + 100;
  const all = new Uint8Array(one.length * count);
  for (let sent = 0; sent < count; sent += 1) all.set(one, sent * one.length);
  server.sendControl(all);
  await pause(50);
  assert.equal(client.statistics.eventsLeftOut, 100);
  let kept = 0;
  while (client.pollEvent() !== undefined) kept += 1;
  assert.equal(kept, 65536);
});

test("a body's bound at a tick is that of its track, and known up to the complete tick", async () => {
  const client = await showing();
  const [id] = client.view.ids;
  const { completeTick } = client;
  const bound = client.tickErrorBound(id, completeTick);
  assert.ok(bound > 0 && bound < 1, `${bound}`);
  assert.equal(client.tickErrorBound(id, completeTick + 1000), Infinity);
  assert.equal(client.tickErrorBound(4711, completeTick), undefined);
  assert.equal(client.errorBound(4711), undefined);
  assert.ok(client.errorBound(id) < 1);
  for (const tick of [-1, 1.5, Number.NaN]) {
    assert.throws(() => client.tickErrorBound(id, tick), { code: "argument", message: /tick is/ });
  }
});

test("refusals are events alone where the application says so", async () => {
  const { client, server } = await joined({ refusals: "events" });
  server.sendControl(message("Refused, 2 of a body"));
  await pause(10);
  client.poll();
  assert.ok(eventKinds(client).includes("refused"));
  const connection = await connect(URL, { transport: Transport });
  await assert.rejects(connection.join("golden", { refusals: "never" }), { code: "argument" });
});

test("a moment of another clock is refused and leaves the client's alone", async () => {
  const client = await showing();
  const { time } = client.view;
  for (const now of [Number.NaN, -1, Infinity, "5", null, Date.now(), performance.now() - 11_000, performance.now() + 11_000]) {
    assert.throws(() => client.poll(now), { code: "argument", message: /now is/ }, String(now));
  }
  client.poll(Math.max(0, performance.now() - 5000));
  client.poll();
  assert.equal(client.view.time, time);
  for (const ticks of [Number.NaN, -1, Infinity, "x"]) {
    assert.throws(() => client.show(ticks), { code: "argument", message: /ticks is/ });
  }
});

test("what a call does not know, and numbers that are not finite, are refused by name", async () => {
  const { client } = await joined();
  const body = { kind: "dynamic", shape: { kind: "ball", radius: 0.5 } };
  for (const [call, named] of [
    [() => client.addBody({ ...body, velocity: [5, 0, 0] }), /bodies\[0\]\.velocity is not known: the fields here are .*linearVelocity/],
    [() => client.addBody({ ...body, shape: { kind: "ball", radius: 0.5, halfHeight: 1 } }), /bodies\[0\]\.shape\.halfHeight is/],
    [() => client.addBody({ ...body, gravityScale: Number.NaN }), /gravityScale is NaN/],
    [() => client.addBody({ ...body, position: [0, Infinity, 0] }), /Infinity/],
    [() => client.command({ kind: "setGravity", gravity: [0, 0, 0], body: 1 }), /command\.body is not known/],
    [() => client.query([{ kind: "ray", origin: [0, 0, 0], direction: [0, 1, 0], translation: [0, 1, 0] }]), /direction is not known/],
    [() => client.changeStream({ within: 0.05, buget: 1000 }), /buget is not known/],
    [
      () => client.addBody({ kind: "fixed", shape: { kind: "heights", rows: 3, columns: 3, rowSpacing: 1, columnSpacing: 1, heights: [0, 0] } }),
      /2 heights are not 3 rows of 3 columns/,
    ],
    [() => client.setSmooth("no"), /smooth is "no"/],
    [() => client.setDelayTicks(null), /ticks is null/],
    [() => client.publish("x"), /states is "x"/],
    [() => client.record(5), /record is 5/],
  ]) {
    assert.throws(call, (error) => error.code === "argument" && named.test(error.message.replace(": ", " ")) || assert.fail(error.message));
  }
  client.addBody({ ...body, position: new Float32Array([0, 60, 0]) });
  for (const options of [{ tolerance: 0.001 }, { delayTick: 6 }, { resumeWithin: -1 }, { resumeWithin: Number.NaN }, { record: 5 }, null]) {
    const connection = await connect(URL, { transport: Transport });
    await assert.rejects(connection.join("golden", options), { code: "argument" }, JSON.stringify(options));
  }
  for (const options of [{ certificatHashes: [] }, { timeout: Infinity }, { timeout: 0 }, { token: 5 }, { certificateHashes: "ab" }]) {
    await assert.rejects(connect(URL, { transport: Transport, ...options }), { code: "argument" }, JSON.stringify(options));
  }
});

test("a call that waits ends within the time limit", async () => {
  const connection = await connect(URL, { transport: Transport, timeout: 200 });
  const joining = connection.join("golden", { resumeWithin: 0 });
  servers.at(-1).play(BEGINNING);
  const client = await joining;
  clients.push(client);
  for (const call of ["advance", "inspect", "delete"]) {
    assert.equal((await settled(client[call]())).error?.code, "timeout", call);
  }
});

test("while a client resumes, no bound is known and all arrays are of one length", async () => {
  const connection = await connect(URL, { transport: Transport });
  const server = servers.at(-1);
  const joining = connection.join("golden", { resumeWithin: 60 });
  server.play(BEGINNING);
  const client = await joining;
  clients.push(client);
  server.play(FIRST_TICK);
  await until(() => client.completeTick >= 1, "the first tick");
  client.poll();
  assert.ok(client.view.count > 0);
  server.close({ closeCode: 7 });
  await until(() => client.state === "resuming", "the end of the connection");
  client.poll();
  const { count, ids, errorBounds, tolerances, updateTicks } = client.view;
  assert.ok(count > 0);
  assert.deepEqual([errorBounds.length, tolerances.length, updateTicks.length], [count, count, count]);
  assert.ok(errorBounds.every((bound) => bound === Infinity));
  const [first] = client.view.ids;
  assert.deepEqual([client.errorBound(first), client.tickErrorBound(first, 1), ids.length], [Infinity, Infinity, count]);
});

test("a client that resumes ends in time, though a server takes its connection and never answers", async () => {
  const connection = await connect(URL, { transport: Transport });
  const server = servers.at(-1);
  const joining = connection.join("golden", { resumeWithin: 0.4 });
  server.play(BEGINNING);
  const client = await joining;
  clients.push(client);
  const opened = servers.length;
  server.close({ closeCode: 7 });
  await until(() => servers.length > opened, "the second connection");
  await until(() => client.state === "ended", "the end of the client");
  assert.equal(client.state, "ended");
});

/** The message that a scene has moved (PROTOCOL 3.7). */
const moved = (address) => Uint8Array.from([address.length + 2, 128, address.length, ...Buffer.from(address)]);
const PRINT = "ab".repeat(32);

/** The answer of a server without the scene: another one has it. */
function sendOn(server, address, [welcome] = BEGINNING) {
  server.play([welcome]);
  server.sendControl(moved(address));
  return pause(5).then(() => server.close({ closeCode: 11 }));
}

test("a client follows its scene to the server that its own has named, at once, and back after pauses if none answers", async () => {
  const connection = await connect(URL, { transport: Transport, certificateHashes: ["cd".repeat(32)] });
  const joining = connection.join("golden", { resumeWithin: 60 });
  const [server, first] = [servers.at(-1), servers.length];
  server.play(BEGINNING);
  const client = await joining;
  clients.push(client);
  server.sendControl(moved(`rhumb://10.0.0.2#${PRINT}`));
  await pause(5);
  server.close({ closeCode: 11 });
  await until(() => servers.length > first, "the second connection");
  assert.equal(client.state, "resuming");
  const second = servers.at(-1);
  assert.deepEqual([second.url, second.hashes], ["https://10.0.0.2:4433/rhumb/1", ["cd".repeat(32), PRINT]]);
  second.close({ closeCode: 7 });
  await until(() => servers.length > first + 1, "the third connection");
  assert.equal(servers.at(-1).url, `${URL}/rhumb/1`);
});

test("a client joins where the server that it asked sends it", async () => {
  const connection = await connect(URL, { transport: Transport });
  const joining = connection.join("golden", { resumeWithin: 0 });
  const first = servers.length;
  await sendOn(servers.at(-1), "rhumb://[::1]:4444");
  await until(() => servers.length > first, "the second connection");
  const second = servers.at(-1);
  assert.deepEqual([second.url, second.hashes], ["https://[::1]:4444/rhumb/1", []]);
  second.play(BEGINNING);
  const client = await joining;
  clients.push(client);
  assert.equal(client.state, "open");
});

test("a server whose connection ends before the name of another one is read is asked again", async () => {
  const connection = await connect(URL, { transport: Transport, timeout: 5000 });
  const joining = connection.join("golden");
  const first = servers.length;
  servers.at(-1).play([BEGINNING[0]]);
  servers.at(-1).close({ closeCode: 11 });
  await until(() => servers.length > first, "the second connection");
  assert.equal(servers.at(-1).url, `${URL}/rhumb/1`);
  servers.at(-1).play(BEGINNING);
  const client = await joining;
  clients.push(client);
  assert.equal(client.state, "open");
});

test("servers that name each other are asked eight in a row, then after a pause, until the time to join is over", async () => {
  const connection = await connect(URL, { transport: Transport, timeout: 400 });
  const first = servers.length - 1;
  const joining = settled(connection.join("golden"));
  for (let asked = first; asked < first + 10; asked += 1) {
    await until(() => servers.length > asked, "another connection");
    await sendOn(servers[asked], "10.0.0.2:1");
  }
  const urls = servers.slice(first + 1, first + 10).map(({ url }) => url);
  assert.deepEqual(urls, [...Array(8).fill("https://10.0.0.2:1/rhumb/1"), `${URL}/rhumb/1`]);
  assert.equal((await joining).error?.code, "timeout");
});

test("an address that is none counts as no address", async () => {
  for (const address of ["rhumb://h:99999999", "https://h:1", "h:1#no-print", "a/b"]) {
    const { client, server } = await joined();
    const opened = servers.length;
    server.sendControl(moved(address));
    await pause(5);
    server.close({ closeCode: 11 });
    const ending = (await settled(client.closed)).value;
    assert.deepEqual([ending?.closeCode, servers.length], [11, opened], address);
  }
});

test("a client that has ended takes no calls", async () => {
  const client = await showing();
  client.close();
  for (const call of [() => client.poll(), () => client.show(1), () => client.setDelayTicks(3), () => client.setSmooth(true)]) {
    assert.throws(call, { code: "closed" });
  }
});

test("a body that is not in the view has no place", async () => {
  const client = await showing();
  const [first] = client.view.ids;
  assert.equal(client.view.place(first), 0);
  assert.equal(client.view.place(2 ** 20 - 1), undefined);
  for (const id of [null, "0", undefined, Number.NaN]) {
    assert.deepEqual([client.view.place(id), client.errorBound(id), client.body(id)], [undefined, undefined, undefined]);
  }
});

/** As a browser's: closed before it is ready, it is never ready. */
class UnreachedTransport {
  #fail;
  ready = new Promise((_, reject) => (this.#fail = reject));
  closed = this.ready;
  close() {
    this.#fail(new Error("closed before it was ready"));
  }
}

// A rejection that nothing handles fails the test in which it is found.
test("connecting with a signal that was aborted before rejects once", async () => {
  const connecting = connect(URL, { transport: UnreachedTransport, signal: AbortSignal.abort() });
  assert.equal((await settled(connecting)).error?.code, "aborted");
  await pause(10);
});

test("joining with a signal that was aborted before rejects once", async () => {
  const aborting = new AbortController();
  const connection = await connect(URL, { transport: Transport, signal: aborting.signal });
  aborting.abort();
  assert.equal((await settled(connection.join("golden"))).error?.code, "aborted");
  await pause(10);
});

test("a worker sends what its first lines name", async (t) => {
  let handle;
  let answered;
  globalThis.WebTransport = Transport;
  globalThis.addEventListener = (_, listener) => (handle = listener);
  globalThis.postMessage = (message, transfer) => answered(structuredClone(message, { transfer }));
  await import("../worker.js");
  const answer = (data) => {
    const answering = new Promise((resolve) => (answered = resolve));
    handle({ data });
    return answering;
  };
  t.after(() => answer({ kind: "call", id: 1, name: "close" }));
  const opened = servers.length;
  const joining = answer({ kind: "connect", url: URL, options: {}, scene: "golden", join: { resumeWithin: 0 } });
  await until(() => servers.length > opened, "the connection");
  servers.at(-1).play(BEGINNING);
  assert.equal((await joining).kind, "joined");
  servers.at(-1).play(FIRST_TICK);
  let first;
  await until(async () => {
    first = await answer({ kind: "frame" });
    return first.ids?.length > 0;
  }, "a frame with bodies");
  const count = first.ids.length;
  for (const name of ["shapes", "kinds", "tolerances", "errorBounds"]) assert.equal(first[name]?.length, count, name);
  assert.ok(first.tolerances.every((tolerance) => tolerance > 0));
  assert.deepEqual([first.positions.length, first.rotations.length], [3 * count, 4 * count]);
  // The second frame still counts the bodies as described anew.
  await answer({ kind: "frame" });
  const later = await answer({ kind: "frame" });
  for (const name of ["ids", "shapes", "kinds", "tolerances"]) assert.ok(!(name in later), name);
  const connect = { kind: "connect", url: URL, options: {}, scene: "golden", join: { resumeWithin: 0 } };
  assert.equal((await answer(connect)).error?.code, "notNow", "a second client beside the first");
  await answer({ kind: "call", id: 2, name: "close" });
  const rejoining = answer(connect);
  await until(() => servers.length > opened + 1, "the next connection");
  handle({ data: connect });
  servers.at(-1).play(BEGINNING);
  const answers = [await rejoining, await new Promise((resolve) => (answered = resolve))];
  assert.deepEqual(answers.map(({ kind }) => kind), ["error", "joined"], "one client at a time");
  servers.at(-1).play(FIRST_TICK);
  await until(async () => (await answer({ kind: "frame" })).ids?.length === count, "the ids of the next client");
});
