// The client in a real browser against a real server: connects, balls fall within the tolerance, tracks equal Rust's.
//
// Usage: node browser.mjs SERVER REPLAY. Both are binaries of rhumb-tests. Needs rhumb.wasm, and for each browser its driver:
// Chromium with the package playwright-core, Firefox with puppeteer-core (in node_modules of RHUMB_NODE_MODULES, or found
// from here). RHUMB_BROWSERS, with spaces between them, names those to try. A browser that is missing, or its driver, is
// printed as skipped; without any the test passes. No figure of time is asserted.

import { spawn, spawnSync } from "node:child_process";
import { existsSync } from "node:fs";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { extname, join } from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath, pathToFileURL } from "node:url";

const [serverPath, replayPath] = process.argv.slice(2);
const root = fileURLToPath(new URL("..", import.meta.url));
const TYPES = { ".js": "text/javascript", ".wasm": "application/wasm", ".html": "text/html" };
const PAGE = '<!doctype html><title>rhumb</title><link rel="icon" href="data:,">';

/** A package, if it is installed. */
async function installed(name) {
  const paths = [process.env.RHUMB_NODE_MODULES, root].filter((path) => path);
  try {
    const found = await import(pathToFileURL(createRequire(import.meta.url).resolve(name, { paths })));
    return found.default;
  } catch {
    return undefined;
  }
}

// A page of another site may not reach this machine without a permission of its user, which a script cannot give.
const CHROMIUM_FLAGS = ["--no-sandbox", "--disable-features=LocalNetworkAccessChecks,LocalNetworkAccessChecksWebTransport"];

/** Each browser: its name, its places, the package that drives it, and how that launches it. */
const BROWSERS = [
  {
    name: "Chromium",
    places: [process.env.RHUMB_CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser"],
    driver: "playwright-core",
    launch: (playwright, executablePath) => playwright.chromium.launch({ executablePath, args: CHROMIUM_FLAGS }),
  },
  {
    name: "Firefox",
    places: [process.env.RHUMB_FIREFOX, "/usr/bin/firefox-esr", "/usr/bin/firefox"],
    driver: "puppeteer-core",
    launch: (puppeteer, executablePath) => puppeteer.launch({ browser: "firefox", executablePath, headless: true }),
  },
];

/** Displayed bodies that are compared with the truth, at least. */
const COMPARISONS = 10_000;

/** A file of the package, or the empty page. */
async function file(path) {
  if (path === "/") return { body: PAGE, type: TYPES[".html"] };
  return { body: await readFile(join(root, path)), type: TYPES[extname(path)] };
}

function serveFiles() {
  const server = createServer((request, response) => {
    file(new URL(request.url, "http://x").pathname).then(
      ({ body, type }) => response.writeHead(200, { "content-type": type }).end(body),
      () => response.writeHead(404).end(),
    );
  });
  return new Promise((resolve) => server.listen(0, "127.0.0.1", () => resolve(server)));
}

/** A server; `listen` may be the address of one that was killed. */
function startServer(listen, more = []) {
  const process = spawn(serverPath, ["--open", "--listen", listen, "--log", "off", ...more]);
  const hashes = [];
  return new Promise((resolve, reject) => {
    let address;
    process.once("exit", (code) => reject(new Error(`the server ended with code ${code}`)));
    createInterface({ input: process.stdout }).on("line", (line) => {
      address ??= line.match(/^listening on (.*)$/)?.[1];
      const hash = line.match(/^certificate hash for browsers (.*)$/)?.[1];
      if (hash && hashes.push(hash) === 2) resolve({ process, address, hashes });
    });
  });
}

function check(condition, what) {
  if (!condition) throw new Error(what);
  console.log(`ok: ${what}`);
}

/**
 * In the page: a pit of balls, a copy within 5 cm, and the truth beside it. A slow machine needs more ticks than that for
 * so many comparisons, six times as many at most.
 */
async function ballsFall({ url, hashes, balls, ticks, comparisons }) {
  const { connect, RhumbError } = await import("/rhumb.js");
  const recording = [];
  const record = (channel, bytes) => {
    const kind = { controlDown: "control", stateDown: "datagram" }[channel];
    if (kind) recording.push([kind, Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("")]);
  };
  const options = { certificateHashes: hashes };
  const shown = { smooth: false, resumeWithin: 0 };
  const mode = { createOrJoin: { stepping: "freeRunning" } };
  const copy = await (await connect(url, options)).join("browser", { ...shown, mode, record });
  const truth = await (await connect(url, options)).join("browser", { ...shown, stream: "full" });
  const wall = { kind: "fixed", shape: { kind: "cuboid", halfExtents: [6, 0.5, 6] } };
  copy.addBodies([{ ...wall, position: [0, -0.5, 0] }]);
  const added = [];
  for (let ball = 0; ball < balls; ball += 1) {
    const [x, y, z] = [ball % 10, Math.floor(ball / 100), Math.floor(ball / 10) % 10];
    const position = [x - 4.5 + 0.01 * y, 1 + 1.05 * y, z - 4.5 + 0.013 * y];
    added.push({ kind: "dynamic", shape: { kind: "ball", radius: 0.4 }, position });
  }
  copy.addBodies(added);
  let [compared, worst, shownTicks, last] = [0, 0, 0, -1];
  const failed = [];
  while (copy.completeTick < ticks || (compared < comparisons && copy.completeTick < 6 * ticks)) {
    await new Promise((resolve) => setTimeout(resolve, 5));
    // The full stream has the states of its newest tick alone.
    const tick = truth.completeTick;
    for (let event = copy.pollEvent(); event; event = copy.pollEvent()) {
      if (["refused", "ended", "checksumMismatch"].includes(event.kind)) failed.push(JSON.stringify(event));
    }
    if (failed.length > 0 || truth.state !== "open") break;
    if (tick === last || copy.completeTick < tick) continue;
    last = tick;
    copy.show(tick);
    truth.show(tick);
    shownTicks += 1;
    if (copy.digest.converged) recording.push(["known", copy.digest]);
    const [ids, bounds] = [copy.view.ids.slice(), copy.view.errorBounds.slice()];
    const [at, turn] = [copy.view.positions.slice(), copy.view.rotations.slice()];
    const [trueAt, trueTurn] = [truth.view.positions, truth.view.rotations];
    for (const [place, id] of ids.entries()) {
      const other = truth.view.place(id);
      if (other === undefined || bounds[place] === Infinity) continue;
      const gap = Math.hypot(...[0, 1, 2].map((axis) => at[3 * place + axis] - trueAt[3 * other + axis]));
      const dot = [0, 1, 2, 3].reduce((sum, axis) => sum + turn[4 * place + axis] * trueTurn[4 * other + axis], 0);
      const error = gap + 2 * 0.4 * Math.sqrt(Math.max(0, 1 - dot * dot));
      worst = Math.max(worst, error);
      compared += 1;
      // The columns are f32: a millimetre more is their rounding, and that of the walls' corners.
      if (error > bounds[place] + 0.001) failed.push(`body ${id} at tick ${tick}: ${error} m off, bound ${bounds[place]}`);
    }
  }
  const inspection = await copy.inspect();
  const result = {
    compared, worst, shownTicks, failed: failed.slice(0, 3), count: copy.view.count, generation: copy.view.generation,
    bodies: inspection.bodies, statistics: copy.statistics, recording, isError: RhumbError.prototype instanceof Error,
    track: copy.track(copy.view.ids[1]), shape: copy.shape(copy.view.shapes[1]), stream: copy.stream,
  };
  copy.close();
  truth.close();
  return result;
}

/** In a page: the error of an attempt to join. */
async function refusal({ url, hashes }) {
  const { connect } = await import("/rhumb.js");
  try {
    const connection = await connect(url, { certificateHashes: hashes });
    await connection.join("browser", { mode: { createOrJoin: {} } });
    return "joined";
  } catch ({ code, closeCode, message }) {
    return { code, closeCode, message };
  }
}

/** In a page: a client in a worker, and one frame of it. */
function inWorker({ url, hashes }) {
  const worker = new Worker("/worker.js", { type: "module" });
  return new Promise((resolve, reject) => {
    worker.onmessage = ({ data }) => {
      if (data.kind === "joined") worker.postMessage({ kind: "frame" });
      else if (data.kind === "frame") {
        resolve({ count: data.ids.length, positions: data.positions.length, tolerances: data.tolerances?.length });
      } else reject(new Error(JSON.stringify(data)));
    };
    const join = { mode: "join" };
    worker.postMessage({ kind: "connect", url, options: { certificateHashes: hashes }, scene: "browser", join });
  });
}

/** In a page: a member waits for a thousand ticks and for an inspection, and another one deletes the scene. */
async function deletion({ url, hashes }) {
  const { connect } = await import("/rhumb.js");
  const mode = { createOrJoin: { rate: { ticks: 1000, seconds: 1 }, publishInterval: 1000 } };
  const member = async () => (await connect(url, { certificateHashes: hashes })).join("deleted", { mode });
  const [waiting, deleting] = [await member(), await member()];
  const ball = { kind: "dynamic", shape: { kind: "ball", radius: 0.5 } };
  waiting.addBodies(Array.from({ length: 200 }, (_, place) => ({ ...ball, position: [0, 1.1 * place, 0] })));
  const late = new Promise((resolve) => setTimeout(() => resolve("nothing"), 10_000));
  const codeOf = (promise) => Promise.race([late, promise.then(() => "done", ({ code }) => code)]);
  const advanced = codeOf(waiting.advance());
  await deleting.delete();
  const closed = Promise.race([late, waiting.closed.then(({ code }) => code)]);
  const codes = [await advanced, await closed, await codeOf(waiting.inspect())];
  return { codes, states: [waiting.state, deleting.state] };
}

/** In a page: joins a durable scene, and waits until it continues after its server was killed. */
async function goesOn(url) {
  const { connect } = await import("/rhumb.js");
  const options = { certificateHashes: () => globalThis.presentHashes() };
  const connection = await connect(url, options);
  const client = await connection.join("durable", { mode: { createOrJoin: {} }, resumeWithin: 60 });
  const ball = client.addBody({ kind: "dynamic", shape: { kind: "ball", radius: 0.5 }, position: [0, 9, 0] });
  for (let tick = 0; tick < 5; tick += 1) await client.advance();
  for (let durable = false; !durable; ) {
    await new Promise((resolve) => setTimeout(resolve, 5));
    for (let event = client.pollEvent(); event; event = client.pollEvent()) {
      durable ||= event.kind === "durable" && event.commands >= 2;
    }
  }
  await globalThis.killServer();
  const kinds = [];
  while (!kinds.includes("resumed") && client.state !== "ended") {
    await new Promise((resolve) => setTimeout(resolve, 20));
    for (let event = client.pollEvent(); event; event = client.pollEvent()) kinds.push(event.kind);
  }
  const after = client.state === "open" ? await client.advance() : undefined;
  const place = client.view.place(ball);
  client.close();
  return { kinds, after, place, ending: client.ending?.message };
}

async function run(page, browser, folder) {
  let server = await startServer("127.0.0.1:0", ["--data", join(folder, "data")]);
  const { address, hashes } = server;
  const url = `https://${address}`;
  try {
    const fell = await page.evaluate(ballsFall, { url, hashes, balls: 500, ticks: 300, comparisons: COMPARISONS });
    const { compared, worst, shownTicks, failed, statistics, recording } = fell;
    console.log(
      `${shownTicks} ticks, ${compared} bodies compared, the worst ${(1000 * worst).toFixed(1)} mm off; ` +
        `${statistics.updates} updates in ${statistics.receivedDatagramBytes} bytes of ${statistics.receivedDatagrams} datagrams`,
    );
    check(failed.length === 0, `every copy is within its bound ${failed}`);
    check(fell.count === 501 && fell.bodies === 501 && fell.isError, "all 501 bodies are shown");
    check(compared >= COMPARISONS && statistics.updates > 500, "enough was compared");
    check(fell.track.state.position.length === 3 && fell.stream.within === 0.05, "a track and the stream are described");

    const path = join(folder, "recording.json");
    await writeFile(path, JSON.stringify({ streams: [{ name: "a browser", events: recording }] }));
    const replayed = spawnSync(replayPath, [path], { encoding: "utf8" });
    check(replayed.status === 0, `the Rust client holds the same bits: ${replayed.stdout.trim()}`);

    const worked = await page.evaluate(inWorker, { url, hashes });
    check(worked.count === 501 && worked.positions === 3 * 501, "a worker shows the same scene");
    check(worked.tolerances === 501, "a worker sends the tolerances");

    const { codes, states } = await page.evaluate(deletion, { url, hashes });
    check(codes.every((code) => code === "sceneDeleted"), `a deleted scene ends what its members wait for: ${codes}`);
    check(states.every((state) => state === "ended"), "a deleted scene ends its members");

    const wrong = await page.evaluate(refusal, { url, hashes: ["00".repeat(32)] });
    check(wrong.code === "connect" && wrong.message.includes("certificateHashes"), `another certificate: ${wrong.message}`);

    const foreign = await browser.newPage();
    if (foreign.route !== undefined) {
      await foreign.route("https://pages.example/**", async (route) => {
        const { body, type } = await file(new URL(route.request().url()).pathname);
        await route.fulfill({ body, contentType: type });
      });
      await foreign.goto("https://pages.example/");
      const other = await foreign.evaluate(refusal, { url, hashes });
      const named = other.message.includes("pages of https://pages.example by --web-origin");
      check(other.code === "connect" && named, `another origin: ${other.message}`);
    } else {
      console.log("not tried: a page of another origin, which this driver cannot serve");
    }

    await page.exposeFunction("presentHashes", () => server.hashes);
    await page.exposeFunction("killServer", async () => {
      server.process.removeAllListeners("exit");
      const gone = new Promise((resolve) => server.process.once("exit", resolve));
      server.process.kill("SIGKILL");
      await gone;
      server = await startServer(address, ["--data", join(folder, "data")]);
    });
    const went = await page.evaluate(goesOn, url);
    check(went.kinds.includes("interrupted") && went.after > 0 && went.place >= 0, `a client continues: ${JSON.stringify(went)}`);
  } finally {
    server.process.removeAllListeners("exit");
    server.process.kill();
  }
}

const files = await serveFiles();
for (const { name, places, driver, launch } of BROWSERS) {
  if (process.env.RHUMB_BROWSERS && !process.env.RHUMB_BROWSERS.split(" ").includes(name)) continue;
  const place = places.find((path) => path && existsSync(path));
  const library = await installed(driver);
  if (place === undefined || library === undefined) {
    console.log(`${name} skipped: ${place === undefined ? name : driver} is not installed`);
    continue;
  }
  const folder = await mkdtemp(join(tmpdir(), "rhumb-browser-"));
  const browser = await launch(library, place);
  try {
    console.log(`${name}: ${await browser.version()}`);
    const page = await browser.newPage();
    page.on("console", (line) => console.log(`page: ${line.text()}`));
    page.on("pageerror", (error) => console.log(`page: ${error.message}`));
    await page.goto(`http://127.0.0.1:${files.address().port}/`);
    await run(page, browser, folder);
  } catch (error) {
    console.log(`FAILED in ${name}: ${error.message}`);
    process.exitCode = 1;
  } finally {
    await browser.close();
    await rm(folder, { recursive: true, force: true });
  }
}
files.close();
