// The WebAssembly module: loaded once, and its memory as JavaScript sees it.
//
// Pointers are valid until the next call into the module, which may make its memory grow.

import { RhumbError } from "./error.js";

let exports;
let loading;

/** Loads the module, once; later calls wait for the first. */
export function load(wasm) {
  loading ??= instantiate(wasm ?? new URL("./rhumb.wasm", import.meta.url)).catch((cause) => {
    loading = undefined;
    throw cause;
  });
  return loading;
}

async function instantiate(wasm) {
  let source = await wasm;
  if (typeof source === "string" || source instanceof URL) source = await fetched(source);
  if (typeof Response !== "undefined" && source instanceof Response) {
    if (!source.ok) {
      const message = `the module ${source.url} was not found (status ${source.status}): build it by bindings/web/build`;
      throw new RhumbError({ code: "argument", message });
    }
    source = await source.arrayBuffer();
  }
  const module = source instanceof WebAssembly.Module ? source : await WebAssembly.compile(source);
  ({ exports } = await WebAssembly.instantiate(module, {}));
}

/** Browsers fetch; Node reads files itself. */
async function fetched(place) {
  const url = new URL(place, import.meta.url);
  if (url.protocol !== "file:") return fetch(url);
  const { readFile } = await import("node:fs/promises");
  return readFile(url);
}

/** The functions of the module. */
export function module() {
  if (exports === undefined) {
    throw new RhumbError({ code: "notNow", message: "the module is not loaded: await load() first" });
  }
  return exports;
}

const encoder = new TextEncoder();
const decoder = new TextDecoder();

/** Gives bytes to the next call. */
export function giveBytes(bytes) {
  const place = module().input(bytes.length);
  new Uint8Array(exports.memory.buffer, place, bytes.length).set(bytes);
}

/** JSON has no such numbers: it would write null, and the field would count as left out. Typed arrays become lists. */
function checked(field, value) {
  if (typeof value === "number" && !Number.isFinite(value)) {
    const place = /^\d*$/.test(field) ? "a number" : field;
    throw new RhumbError({ code: "argument", message: `${place} is ${value}, and must be finite` });
  }
  return ArrayBuffer.isView(value) ? Array.from(value) : value;
}

/** Gives a value to the next call. */
export function give(value) {
  const json = JSON.stringify(value, checked);
  if (json === undefined) throw new RhumbError({ code: "argument", message: `an argument is ${String(value)}` });
  giveBytes(encoder.encode(json));
}

/** A copy of the output of the last call. */
export function outputBytes() {
  return new Uint8Array(exports.memory.buffer, exports.output(), exports.output_bytes()).slice();
}

/** The output of the last call as a value. */
export function output() {
  return JSON.parse(decoder.decode(outputBytes()));
}

/** The output of a call that returns 0 if it failed. */
export function answer(succeeded) {
  const value = output();
  if (succeeded === 0) throw new RhumbError(value);
  return value;
}

/** The output of a call that returns 0 if there is none. */
export function found(any) {
  return any === 0 ? undefined : output();
}

/** Numbers of the module's memory, in place. */
export function numbers(Type, place, entries) {
  return new Type(exports.memory.buffer, entries === 0 ? 0 : place, entries);
}
