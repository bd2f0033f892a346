// Checks how many bytes of a module are downloaded.
//
// Usage: node size.mjs MODULE.wasm. The exit code is 1 above the limit.

import { readFile } from "node:fs/promises";
import { brotliCompressSync, gzipSync } from "node:zlib";

/** Bytes after Brotli, at its highest quality: what a web server sends. */
const LIMIT = 341_000;

const bytes = await readFile(process.argv[2]);
const brotli = brotliCompressSync(bytes).length;
console.log(`${bytes.length} bytes, ${gzipSync(bytes, { level: 9 }).length} by gzip, ${brotli} by brotli`);
if (brotli > LIMIT) {
  console.log(`more than the limit of ${LIMIT} by brotli`);
  process.exitCode = 1;
}
