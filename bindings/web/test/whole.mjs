// Fails where a file of the package is missing: npm packs what there is, without a word.

import { existsSync, readFileSync } from "node:fs";

const root = new URL("../", import.meta.url);
const { files } = JSON.parse(readFileSync(new URL("package.json", root)));
const missing = files.filter((file) => !file.includes("*") && !existsSync(new URL(file, root)));
if (missing.length > 0) {
  console.error(`missing: ${missing.join(", ")}; run bindings/web/build first`);
  process.exitCode = 1;
}
