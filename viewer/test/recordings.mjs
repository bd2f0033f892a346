// Recordings dropped on the page in Chromium: it plays and scrubs them, and shows the poses that the files have. A page without
// a server does the same.
//
// Usage: node recordings.mjs RHUMB_SERVER TRACE, a trace of `rhumb-bench evaluate`. A recording of the server is made here.
// Python reads the files for comparison (RHUMB_TEST_PYTHON, with the packages that poses.py names).

import { execFileSync, spawnSync } from "node:child_process";
import { createServer } from "node:http";
import { mkdir, mkdtemp, readFile, readdir, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { basename, join } from "node:path";
import { fileURLToPath } from "node:url";
import { Missing, openChromium, pause } from "./browsers.mjs";
import { check, choose, kill, LIMIT, openPage, read, slide, startDemo, startServer, text, until } from "./support.mjs";

const [binary, trace] = process.argv.slice(2);
if (trace === undefined) {
  console.error("usage: node recordings.mjs RHUMB_SERVER TRACE");
  process.exit(2);
}
const python = process.env.RHUMB_TEST_PYTHON ?? "python3";
const here = fileURLToPath(new URL(".", import.meta.url));
const STEP = 1 / 60;
/** Metres, and units of a rotation: the page's numbers have 32 bits. */
const ROUNDING = 2e-6;

/** The output of a Python program. */
function runPython(options, input) {
  const { status, stdout, stderr, error } = spawnSync(python, options, { input, maxBuffer: 1e9 });
  if (status !== 0) throw new Error(`${python} ${options[0]}: ${error ?? stderr}`);
  return stdout;
}

/** Drops a file on the page, as a hand does with one of a file manager. */
async function drop(page, path) {
  const session = await page.context().newCDPSession(page);
  const data = { items: [], files: [path], dragOperationsMask: 1 };
  for (const type of ["dragEnter", "dragOver", "drop"]) {
    await session.send("Input.dispatchDragEvent", { type, x: 200, y: 150, data });
  }
  await session.detach();
}

/** In the page: steps a scene of many shapes by its own client, which ends the scene, and so its recording. */
async function recordScene(facts) {
  const { connect } = await import("/client/rhumb.js");
  const connection = await connect(facts.url, { certificateHashes: facts.certificateHashes });
  const client = await connection.join("shapes", { mode: { createOrJoin: { stepping: "lockstep" } } });
  const ball = { kind: "ball", radius: 0.5 };
  const shapes = [
    ball,
    { kind: "cuboid", halfExtents: [0.3, 0.4, 0.5] },
    { kind: "capsule", halfHeight: 0.5, radius: 0.3 },
    { kind: "cylinder", halfHeight: 0.4, radius: 0.3 },
    { kind: "cone", halfHeight: 0.5, radius: 0.4 },
    { kind: "roundedCuboid", halfExtents: [0.3, 0.3, 0.3], radius: 0.1 },
    { kind: "hull", points: [0.5, 0, 0, -0.5, 0, 0.4, -0.5, 0, -0.4, 0, 0.7, 0] },
    { kind: "compound", parts: [-0.4, 0.4].map((x) => ({ position: [x, 0, 0], rotation: [0, 0, 0, 1], shape: ball })) },
  ];
  const still = [
    { kind: "halfSpace", normal: [0, 1, 0] },
    { kind: "heights", rows: 3, columns: 2, rowSpacing: 1, columnSpacing: 2, heights: [0, 0.5, 1, 0.5, 0, 0] },
    { kind: "mesh", points: [0, 0, 0, 3, 0, 0, 0, 0, 3, 0, 2, 0], triangles: [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3] },
  ];
  still.forEach((shape, at) => client.addBody({ kind: "fixed", shape, position: [5 * at, 0, -12] }));
  client.addBody({ kind: "fixed", shape: { kind: "cuboid", halfExtents: [20, 0.5, 20] }, position: [0, -0.5, 0] });
  const place = (shape, at) => ({ kind: "dynamic", shape, position: [2 * at - 6, 3 + 0.3 * at, 0], angularVelocity: [1, 2, at] });
  const added = client.addBodies(shapes.map(place));
  for (let tick = 0; tick < 150; tick++) {
    if (tick === 60) client.addBody({ kind: "dynamic", shape: shapes[0], position: [0, 9, 3] });
    if (tick === 90) client.command({ kind: "removeBody", id: added[2] });
    await client.advance();
  }
  await client.delete();
  client.close();
}

/** Makes a recording of a server, and resolves with its path when it is whole. */
async function makeRecording(page, server, folder) {
  const facts = await (await fetch(new URL("connect.json", server.url))).json();
  await page.evaluate(recordScene, facts);
  for (const end = performance.now() + LIMIT; performance.now() < end; await pause(100)) {
    for (const name of await readdir(folder)) {
      const path = join(folder, name);
      const bytes = await readFile(path);
      const isWhole = bytes.subarray(-8).equals(Buffer.from("\x89MCAP0\r\n", "latin1"));
      if (isWhole && bytes.length > 1000) return path;
    }
  }
  throw new Error("the server finished no recording");
}

/** The bodies that the page shows at a tick of the recording, which it is made to scrub to. */
async function posesShown(page, tick) {
  await slide(page, "scrubber", Math.round(1000 * tick * STEP));
  await until(page, `d.shown.time === ${tick}`);
  return page.evaluate(() => {
    const { positions, rotations, time } = rhumbDiagnostics.shown;
    return { time, positions: Array.from(positions), rotations: Array.from(rotations) };
  });
}

/** Compares what the page shows at some ticks with the poses of the file; forwards and back. */
async function comparePoses(page, path, run, load = "") {
  const { ticks } = JSON.parse(runPython([join(here, "poses.py"), path, `${load}/${run}`, "0"]));
  const last = ticks - 1;
  const chosen = [0, 1, 7, 61, 40, 121, 119, 100, last, 30, 90, 89, 12].filter((tick) => tick <= last);
  const file = JSON.parse(runPython([join(here, "poses.py"), path, `${load}/${run}`, ...chosen.map(String)]));
  let compared = 0;
  for (const tick of chosen) {
    const { positions, rotations } = await posesShown(page, tick);
    for (const [place, pose] of Object.entries(file.poses[tick])) {
      const shown = [...positions.slice(3 * place, 3 * place + 3), ...rotations.slice(4 * place, 4 * place + 4)];
      const worst = Math.max(...shown.map((value, part) => Math.abs(value - pose[part]) / Math.max(1, Math.abs(pose[part]))));
      if (!(worst <= ROUNDING)) throw new Error(`body ${place} at tick ${tick}: ${shown} is shown, but ${pose} recorded`);
      compared++;
    }
  }
  check(compared > chosen.length, `${compared} poses of ${chosen.length} ticks are those of ${basename(path)}`);
}

async function plays(page, path, said) {
  await drop(page, path);
  // Until it is read, the page says so, and an earlier recording continues.
  const named = `document.getElementById("status").textContent.startsWith(${JSON.stringify(basename(path))})`;
  await until(page, `${named} && document.getElementById("moment").textContent.includes(" of ")`);
  const status = await text(page, "status");
  check(said.test(status), `it plays: ${status}`);
  await until(page, "d.shown !== undefined");
  const { time } = await page.evaluate(() => rhumbDiagnostics.shown);
  await until(page, `d.shown.time > ${time}`);
  return status;
}

/** An .rhtrace of two boxes, one of which rises a decimetre in each frame. */
function boxes(frames) {
  const bodies = 2;
  const bytes = Buffer.alloc(8 + 8 + 4 + 12 + 16 * bodies + 2 * frames + 55 * (frames + 1));
  let at = bytes.write("RHTRACE1", "latin1");
  const u16 = (value) => (at = bytes.writeUInt16LE(value, at));
  const f32 = (value) => (at = bytes.writeFloatLE(value, at));
  at = bytes.writeUInt32LE(frames, bytes.writeUInt32LE(bodies, at));
  for (const value of [STEP, 0, -9.8, 0]) f32(value);
  for (let body = 0; body < bodies; body++) for (const value of [0.5, 0.5, 0.5, Math.hypot(0.5, 0.5, 0.5)]) f32(value);
  for (let frame = 0; frame < frames; frame++) {
    const moved = frame === 0 ? [0, 1] : [1];
    u16(moved.length);
    for (const body of moved) {
      u16(body);
      for (const value of [2 * body, 0.5 + 0.1 * frame * body, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]) f32(value);
      at = bytes.writeUInt8(1, at);
    }
  }
  return bytes;
}

async function otherForms(page, folder) {
  const frames = 300;
  const pack = "import sys, zstandard; sys.stdout.buffer.write(zstandard.compress(sys.stdin.buffer.read()))";
  const packed = runPython(["-c", pack], boxes(frames));
  for (const [name, bytes] of [["boxes.rhtrace", boxes(frames)], ["boxes.rhtrace.zst", packed]]) {
    const path = join(folder, name);
    await writeFile(path, bytes);
    await plays(page, path, /: 2 boxes, 300 frames/);
    for (const tick of [10, 299, 0, 200]) {
      const { positions } = await posesShown(page, tick);
      const expected = [0, 0.5, 0, 2, Math.fround(0.5 + 0.1 * tick), 0];
      if (positions.some((value, part) => value !== expected[part])) throw new Error(`${name} at ${tick}: ${positions}`);
    }
    check(true, `${name} is scrubbed to the poses that it has`);
  }
  check(
    await page.evaluate(() => document.getElementById("headline").hidden && !document.getElementById("pictures").classList.contains("two")),
    "without a copy there is one picture, and no numbers",
  );
  await aBodyIsPicked(page);
  const whole = await readFile(trace);
  const early = join(folder, "early.mcap");
  await writeFile(early, whole.subarray(0, endOfChunks(whole)));
  await plays(page, early, /; the file ends early/);
  const cut = join(folder, "cut.mcap");
  await writeFile(cut, whole.subarray(0, 900));
  await drop(page, cut);
  await until(page, () => document.getElementById("status").textContent.includes("cannot be played"));
  check(true, `a damaged one is refused: ${await text(page, "status")}`);
}

/** Where the last chunk of an MCAP file ends: there, a recorder that crashes leaves it. */
function endOfChunks(file) {
  let end = 0;
  for (let at = 8; at + 9 <= file.length;) {
    const isChunk = file[at] === 0x06;
    at += 9 + Number(file.readBigUInt64LE(at + 1));
    if (isChunk) end = at;
  }
  return end;
}

/** The box that stays where it is. */
async function aBodyIsPicked(page) {
  await page.mouse.click(...(await page.evaluate(() => rhumbDiagnostics.screenOf(0))));
  await until(page, () => document.getElementById("body-facts").textContent.includes("0.00, 0.50, 0.00 m"));
  await posesShown(page, 210);
  await until(page, "d.trail.points > 0");
  check(true, "a body of a recording is picked, and its way drawn");
}

/** A recording continues, whatever becomes of the live connection behind it. */
async function connectionsComeAndGo(browser, path) {
  let demo = await startDemo(binary);
  try {
    const page = await openPage(browser, demo.url);
    await plays(page, path, /: 2 boxes, 300 frames/);
    await until(page, "d.state === 'open' && d.bodies > 0");
    const { bodies } = await read(page);
    await aBodyIsPicked(page);
    await kill(demo);
    await until(page, "d.state === 'lost'");
    demo = await startDemo(binary, { view: demo.view });
    await until(page, "d.state === 'open'");
    check(await page.evaluate(() => document.getElementById("notice").hidden), "no notice covers a recording");
    check((await text(page, "body-facts")).includes("0.50"), "the picked body is that of the recording still");
    await page.keyboard.press("Delete");
    await posesShown(page, 100);
    await until(page, `d.bodies === ${bodies}`);
    const { frames } = await read(page);
    await until(page, `d.frames > ${frames + 10}`);
    check((await read(page)).bodies === bodies, "no key removes the live body of its number");
    const drawn = await page.evaluate(() => [0, 1].map((place) => rhumbDiagnostics.drawnPosition(place)));
    const expected = [[0, 0.5, 0], [2, Math.fround(0.5 + 0.1 * 100), 0]];
    check(JSON.stringify(drawn) === JSON.stringify(expected), `all bodies are drawn after a restart: ${JSON.stringify(drawn)}`);
    await page.close();
  } finally {
    await kill(demo);
  }
}

/** A trace whose chunks are packed by LZ4 and not in the order of time is played as the one that it was made of. */
async function anotherWritersTraceIsPlayed(page, folder) {
  const program = `
import sys
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
reader = make_reader(open(sys.argv[1], "rb"))
writer = Writer(open(sys.argv[2], "wb"), chunk_size=20000, compression=CompressionType.LZ4)
writer.start()
schemas, channels, seconds = {}, {}, {}
for schema, channel, message in reader.iter_messages():
    if channel.topic.endswith(("/state", "/seen", "/stats")):
        seconds.setdefault(message.log_time // 10**9, []).append((schema, channel, message))
for record in reader.iter_metadata():
    writer.add_metadata(record.name, record.metadata)
for second in sorted(seconds, reverse=True):
    for schema, channel, message in seconds[second]:
        if channel.id not in channels:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number, channel.metadata)
        writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
writer.finish()`;
  const path = join(folder, "other.mcap");
  runPython(["-c", program, trace, path]);
  await plays(page, path, /: \d+ bodies, the copy of rhumb[^ ]*, within /);
  const run = await page.evaluate(() => document.getElementById("run").value);
  await comparePoses(page, trace, run);
  check(true, "a trace in chunks of LZ4, out of order, is played");
}

/** The names of the loads and runs of a trace, as Python reads them. */
function loadsOf(path) {
  const program = `
import json, sys
from mcap.reader import make_reader
topics = {c.topic for c in make_reader(open(sys.argv[1], "rb")).get_summary().channels.values()}
loads = [t.removesuffix("/truth/state") for t in topics if t.endswith("/truth/state")]
print(json.dumps({l[1:]: [t.split("/")[2] for t in topics if t.startswith(l + "/") and t.endswith("/seen")] for l in loads}))`;
  return JSON.parse(runPython(["-c", program, path]));
}

/** Every load and run of a trace is offered, played, and named in the address. */
async function everyLoadIsPlayed(page, path) {
  const loads = loadsOf(path);
  const options = (id) => page.evaluate((id) => [...document.getElementById(id).options].map(({ value }) => value), id);
  const offered = await options("load");
  check(offered.toSorted().join() === Object.keys(loads).toSorted().join(), `the page offers the loads ${offered.join(", ")}`);
  for (const load of offered.toReversed()) {
    if (offered.length > 1) await choose(page, "load", load);
    const runs = await options("run");
    check(runs.toSorted().join() === loads[load].toSorted().join(), `of ${load} it offers the runs ${runs.join(", ")}`);
    for (const run of runs) {
      if (runs.length > 1) await choose(page, "run", run);
      await until(page, `document.getElementById("status").textContent.includes("the copy of ${run}")`);
      await comparePoses(page, path, run, load);
    }
    const asked = new URLSearchParams(await page.evaluate(() => location.search));
    if (runs.length > 1) check(asked.get("load") === load && runs.includes(asked.get("run")), `the address says ${asked}`);
  }
}

/** The errors that the page shows are those that the copy has, and full states at the same bytes are no better. */
async function bothPicturesAreCompared(page) {
  await posesShown(page, 0);
  await page.keyboard.press("KeyP");
  await until(page, "d.sums.worst > 0.01 && d.sums.besideWorst > 1");
  const { sums } = await read(page);
  check(sums.worst <= 0.0502, `the copy of a recording is off by ${sums.worst.toFixed(4)} m`);
  check(sums.besideWorst > 10 * sums.worst, `and full states at its bytes by ${sums.besideWorst.toFixed(2)} m`);
  check(/×$/.test(await text(page, "times")), `with ${await text(page, "times")} fewer bytes than full states of all`);
}

/** A web server that knows nothing of Rhumb, for the files of a folder; resolves with its address. */
function serveFiles(root, asked) {
  const types = { html: "text/html", js: "text/javascript", css: "text/css", svg: "image/svg+xml" };
  const web = createServer(async ({ url, method }, response) => {
    asked.push(`${method} ${url}`);
    const path = decodeURIComponent(new URL(url, "http://web").pathname);
    try {
      const bytes = await readFile(join(root, path.endsWith("/") ? `${path}index.html` : path));
      response.writeHead(200, { "content-type": types[path.endsWith("/") ? "html" : path.split(".").at(-1)] ?? "application/octet-stream" });
      response.end(bytes);
    } catch {
      response.writeHead(404).end();
    }
  });
  return new Promise((resolve) => web.listen(0, "127.0.0.1", () => resolve({ web, origin: `http://127.0.0.1:${web.address().port}` })));
}

/** A page that was written with recordings plays them below any path, and asks its web host for its own files alone. */
async function aPageWithoutAServerPlays(browser, folder) {
  const site = join(folder, "site");
  const spaced = join(folder, "a trace.mcap");
  await mkdir(join(site, "below"), { recursive: true });
  await writeFile(spaced, await readFile(trace));
  const said = execFileSync(binary, ["page", "--static", join(site, "below/page"), spaced, join(folder, "boxes.rhtrace")], {
    encoding: "utf8",
  });
  check(said.startsWith("wrote the page to"), said.trim());
  const asked = [];
  const { web, origin } = await serveFiles(site, asked);
  try {
    const page = await openPage(browser, `${origin}/below/page/`);
    const refused = [];
    page.on("requestfailed", (request) => refused.push(request.url()));
    await until(page, "d.shown?.time > 3");
    check((await text(page, "status")).startsWith("a trace.mcap: "), "a page without a server plays its first recording");
    await bothPicturesAreCompared(page);
    await everyLoadIsPlayed(page, spaced);
    await choose(page, "scene", "boxes.rhtrace");
    await until(page, () => document.getElementById("status").textContent.startsWith("boxes.rhtrace"));
    check(true, "and another one");
    const outside = asked.filter((request) => !request.startsWith("GET /below/page/"));
    check(outside.length === 0 && refused.length === 0, `it asks for nothing else ${[...outside, ...refused].join()}`);
    check(!asked.some((request) => /client|connect|wasm|link/.test(request.replace("link.js", ""))), "nor for anything of a server");
    const policy = await page.evaluate(() => fetch("https://127.0.0.1:1/").then(() => "passed", () => "refused"));
    check(policy === "refused" && page.errors.some((error) => error.includes("Content Security Policy")), "its policy refuses other addresses");
    const others = page.errors.filter((error) => !error.includes("Content Security Policy"));
    check(others.length === 0, `no error in the page ${others.join("; ")}`);
    await page.close();
  } finally {
    web.close();
  }
}

const folder = await mkdtemp(join(tmpdir(), "rhumb-recordings-"));
let browser, server;
try {
  browser = await openChromium();
  const made = join(folder, "made");
  const listens = ["--listen", "127.0.0.1:0", "--view", "127.0.0.1:0"];
  server = await startServer(binary, ["--open", "--log", "off", ...listens, "--record", made]);
  const page = await openPage(browser, server.url);
  const recording = await makeRecording(page, server, made);
  await plays(page, recording, /: 13 bodies, the truth$/);
  await comparePoses(page, recording, "truth");
  const status = await plays(page, trace, /: \d+ bodies, the copy of rhumb[^ ]*, within /);
  await comparePoses(page, trace, /the copy of ([^ ,]+)/.exec(status)[1]);
  await bothPicturesAreCompared(page);
  await everyLoadIsPlayed(page, trace);
  await anotherWritersTraceIsPlayed(page, folder);
  await otherForms(page, folder);
  await aPageWithoutAServerPlays(browser, folder);
  await connectionsComeAndGo(browser, join(folder, "boxes.rhtrace"));
  await page.keyboard.press("Escape");
  await until(page, () => document.getElementById("moment").textContent === "live");
  check(page.errors.length === 0, `no error in the page ${page.errors.join("; ")}`);
} catch (cause) {
  if (!(cause instanceof Missing)) throw cause;
  console.log(`skipped: ${cause.message}`);
} finally {
  await browser?.close();
  if (server !== undefined) await kill(server);
  await rm(folder, { recursive: true, force: true });
}
