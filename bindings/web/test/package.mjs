// The npm package: its files, its installation in an empty folder, and the example of its README.
//
// Usage: node package.mjs [SERVER], a rhumb-server or rhumb-test-server; needs npm, and rhumb.wasm from bindings/web/build.
// The example runs in Chromium, with playwright-core from RHUMB_NODE_MODULES; without them, or without SERVER, in Node alone.
// TypeScript, if it is there, checks the types.

import { spawn, spawnSync } from "node:child_process";
import { existsSync, readFileSync, readdirSync } from "node:fs";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { extname, join } from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";

const require = createRequire(import.meta.url);
const [serverPath] = process.argv.slice(2);
const root = fileURLToPath(new URL("..", import.meta.url));
const FILES = [
  ...["LICENSE-APACHE", "LICENSE-MIT", "README.md", "client.js", "connection.js", "error.js", "member.js", "module.js"],
  ...["package.json", "rhumb.d.ts", "rhumb.js", "rhumb.wasm", "worker.js"],
];
const TYPES = { ".js": "text/javascript", ".wasm": "application/wasm", ".html": "text/html" };

function check(condition, what) {
  if (!condition) throw new Error(what);
  console.log(`ok: ${what}`);
}

function run(program, options, folder) {
  const { status, stdout, stderr, error } = spawnSync(program, options, { cwd: folder, encoding: "utf8" });
  if (status !== 0) throw new Error(`${program} ${options.join(" ")}: ${error ?? stderr + stdout}`);
  return stdout;
}

/** The example of the installed README, as the text of a module. */
async function example(installed) {
  const readme = await readFile(join(installed, "README.md"), "utf8");
  return /```js\n(.*?)```/s.exec(readme)[1];
}

/** A copy of a recorded stream, held by the installed package in Node. */
const HELD = `
  import { readFile } from "node:fs/promises";
  import { load, Member, RhumbError, connect, isSupported } from "rhumb-web";
  await load();
  const { streams } = JSON.parse(await readFile(process.argv[2]));
  const member = new Member("golden", { join: { mode: "join" } });
  member.handleOpened(0);
  let same = 0;
  for (const [kind, value] of streams[0].events) {
    if (kind === "control") member.handleControl(0, Buffer.from(value, "hex"));
    else if (kind === "datagram") member.handleDatagram(0, Buffer.from(value, "hex"));
    else {
      // Bodies that came are there once a view has shown them.
      member.show(member.completeTick);
      if (value.poses !== undefined && member.digest?.poses === value.poses) same += 1;
    }
  }
  const refusal = await connect("https://127.0.0.1:1").catch((error) => error);
  console.log(JSON.stringify({ same, isSupported, isError: refusal instanceof RhumbError, code: refusal.code }));
`;

async function inNode(folder) {
  await writeFile(join(folder, "held.mjs"), HELD);
  const vectors = fileURLToPath(new URL("../../../spec/vectors/streams.json", import.meta.url));
  const held = JSON.parse(run(process.execPath, ["held.mjs", vectors], folder));
  check(held.same > 0, `the installed package holds the bits of ${held.same} recorded states`);
  check(!held.isSupported && held.isError && held.code === "unsupported", "without WebTransport it says so");
}

/** Compares rhumb.d.ts with what the package exports, and checks the README's example, by the compiler of TypeScript. */
async function typed(folder, code) {
  const paths = [process.env.RHUMB_NODE_MODULES, root].filter((path) => path);
  let compiler;
  try {
    compiler = require.resolve("typescript/lib/tsc.js", { paths });
  } catch {
    console.log("skipped: typescript is not installed");
    return;
  }
  const names = await import(join(folder, "node_modules", "rhumb-web", "rhumb.js"));
  const members = (name) => {
    const { prototype } = names[name];
    const own = Object.getOwnPropertyNames(prototype).filter((member) => member !== "constructor");
    return own.map((member) => `export const ${name}_${member}: keyof rhumb.${name} = ${JSON.stringify(member)};`);
  };
  // A member has more than its type, for the client alone.
  const classes = Object.keys(names).filter((name) => names[name].prototype !== undefined && name !== "Member");
  const all = Object.keys(names).map((name) => `rhumb.${name}`);
  const declared = ['import * as rhumb from "rhumb-web";', `export const all = [${all}];`];
  await writeFile(join(folder, "exports.ts"), [...declared, ...classes.flatMap(members)].join("\n"));
  await writeFile(join(folder, "example.ts"), `declare const certificateHashes: string[];\n${code}`);
  const options = ["--noEmit", "--strict", "--target", "es2022", "--lib", "es2022,dom,dom.iterable", "--module", "nodenext"];
  run(process.execPath, [compiler, ...options, "exports.ts", "example.ts"], folder);
  check(true, `its types have all ${Object.keys(names).length} exports with their members, and fit its example`);
}

function startServer() {
  const server = spawn(serverPath, ["--open", "--listen", "127.0.0.1:0", "--log", "off"]);
  const hashes = [];
  return new Promise((resolve, reject) => {
    let address;
    server.once("exit", (code) => reject(new Error(`the server ended with code ${code}`)));
    createInterface({ input: server.stdout }).on("line", (line) => {
      address ??= line.match(/^listening on (.*)$/)?.[1];
      const hash = line.match(/^certificate hash for browsers (.*)$/)?.[1];
      if (hash && hashes.push(hash) === 2) resolve({ server, address, hashes });
    });
  });
}

/** Serves a folder, and a page whose import map names the package. */
function serve(folder, page) {
  const server = createServer((request, response) => {
    const { pathname } = new URL(request.url, "http://x");
    const type = TYPES[pathname === "/" ? ".html" : extname(pathname)];
    const path = join(folder, pathname);
    if (pathname !== "/" && !existsSync(path)) return response.writeHead(404).end();
    response.writeHead(200, { "content-type": type }).end(pathname === "/" ? page : readFileSync(path));
  });
  return new Promise((resolve) => server.listen(0, "127.0.0.1", () => resolve(server)));
}

async function inChromium(folder, code) {
  const executablePath = [process.env.RHUMB_CHROMIUM, "/usr/bin/chromium"].find((path) => path && existsSync(path));
  const paths = [process.env.RHUMB_NODE_MODULES, root].filter((path) => path);
  let playwright;
  try {
    playwright = require(require.resolve("playwright-core", { paths }));
  } catch {
    playwright = undefined;
  }
  if (executablePath === undefined || playwright === undefined || serverPath === undefined) {
    console.log("skipped in Chromium: it is not installed, or playwright-core, or no SERVER is named");
    return;
  }
  const { server, address, hashes } = await startServer();
  // A scene of the example's name, with a ball, then the example as it stands.
  const prepared = `
    import { connect as open } from "rhumb-web";
    const certificateHashes = ${JSON.stringify(hashes)};
    const maker = await (await open("https://${address}", { certificateHashes })).join("pit", { mode: { createOrJoin: {} } });
    maker.addBody({ kind: "dynamic", shape: { kind: "ball", radius: 0.5 }, position: [1, 2, 3] });
    await maker.advance();
  `;
  const script = prepared + code.replace("https://127.0.0.1:4433", `https://${address}`);
  const map = { imports: { "rhumb-web": "/node_modules/rhumb-web/rhumb.js" } };
  const page =
    `<!doctype html><title>x</title><link rel="icon" href="data:,"><script type="importmap">${JSON.stringify(map)}</script>` +
    `<script type="module">${script}</script>`;
  const files = await serve(folder, page);
  const browser = await playwright.chromium.launch({ executablePath, args: ["--no-sandbox"] });
  try {
    const tab = await browser.newPage();
    const printed = new Promise((resolve, reject) => {
      tab.on("console", async (message) => resolve(await Promise.all(message.args().map((value) => value.evaluate(printable)))));
      tab.on("pageerror", reject);
      setTimeout(() => reject(new Error("the example printed nothing")), 60_000).unref();
    });
    await tab.goto(`http://127.0.0.1:${files.address().port}/`);
    const [count, positions] = await printed;
    check(count === 1 && positions[0] === 1 && positions[2] === 3, `its example prints ${count}, [${positions}]`);
  } finally {
    await browser.close();
    files.close();
    server.removeAllListeners("exit");
    server.kill();
  }
}

/** In the page: arrays as lists. */
function printable(value) {
  return typeof value === "object" ? Array.from(value) : value;
}

const folder = await mkdtemp(join(tmpdir(), "rhumb-package-"));
try {
  const [{ filename, files }] = JSON.parse(run("npm", ["pack", "--json", "--pack-destination", folder], root));
  const names = files.map(({ path }) => path).sort();
  check(names.join() === [...FILES].sort().join(), `the package has ${names.length} files: ${names.join(", ")}`);
  await writeFile(join(folder, "package.json"), '{"private": true, "type": "module"}');
  run("npm", ["install", "--offline", "--no-audit", "--no-fund", `./${filename}`], folder);
  const installed = join(folder, "node_modules", "rhumb-web");
  check(readdirSync(join(folder, "node_modules")).filter((name) => !name.startsWith(".")).join() === "rhumb-web", "it needs no other");
  await inNode(folder);
  await typed(folder, await example(installed));
  await inChromium(folder, await example(installed));
} finally {
  await rm(folder, { recursive: true, force: true });
}
