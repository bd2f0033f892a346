// A live scene: a Rust client leads it and records what it receives; the WebAssembly client then holds the same bits.
//
// Usage: node live.mjs SERVER FOLLOW MODULE.wasm. The first two are binaries of rhumb-tests.

import { spawn, spawnSync } from "node:child_process";
import { mkdtemp, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";

const [serverPath, followPath, wasm] = process.argv.slice(2);
const BODIES = 200;
const TICKS = 300;

/** The first line of a process that the pattern matches. */
function line(lines, pattern) {
  return new Promise((resolve, reject) => {
    lines.on("line", (text) => {
      const found = text.match(pattern);
      if (found) resolve(found[1]);
    });
    lines.on("close", () => reject(new Error(`no line ${pattern}`)));
  });
}

const folder = await mkdtemp(join(tmpdir(), "rhumb-live-"));
const server = spawn(serverPath, ["--open", "--listen", "127.0.0.1:0", "--log", "off"]);
try {
  const said = createInterface({ input: server.stdout });
  const [address, fingerprint] = await Promise.all([line(said, /^listening on (.*)$/), line(said, /^fingerprint (.*)$/)]);
  const recording = join(folder, "recording.json");
  const follow = spawn(
    followPath,
    ["--server", address, "--fingerprint", fingerprint, "--scene", "live", "--bodies", BODIES, "--micrometres", 10000]
      .concat(["--ticks", TICKS, "--out", join(folder, "states.jsonl"), "--record", recording])
      .map(String),
  );
  const lines = createInterface({ input: follow.stdout });
  const [going, done] = [line(lines, /^(going)/), line(lines, /^(done)/)];
  await going;
  follow.stdin.write("\n");
  await done;
  follow.stdin.end();
  const replay = fileURLToPath(new URL("streams.mjs", import.meta.url));
  const { status } = spawnSync(process.execPath, [replay, wasm, recording], { stdio: "inherit" });
  process.exitCode = status ?? 1;
} finally {
  server.kill();
  await rm(folder, { recursive: true, force: true });
}
