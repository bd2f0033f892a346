// Runs a program in WebAssembly that reads files, as a command of this system would.
//
// Usage: node wasi.mjs MODULE.wasm [ARGUMENT ...]. The exit code is the program's.

import { readFile } from "node:fs/promises";
import { WASI } from "node:wasi";

const [module, ...options] = process.argv.slice(2);
const wasi = new WASI({ version: "preview1", args: [module, ...options], env: process.env, preopens: { "/": "/" } });
const { instance } = await WebAssembly.instantiate(await readFile(module), wasi.getImportObject());
process.exitCode = wasi.start(instance);
