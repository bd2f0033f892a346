// Checks the predictors, compiled to WebAssembly, against the golden vectors, bit for bit.
//
// Usage: node check.mjs MODULE.wasm. Prints what failed, then a count; the exit code is 1 if anything did.

import { readFile } from "node:fs/promises";

const LAWS = ["rest", "uniform", "ballistic", "tumbling", "thrown", "pushed"];
const NO_PUSH = { push: [0, 0, 0], doublings: 0 };
const NO_INERTIA = { moments: Array(3).fill("00000000"), frame: Array(4).fill("00000000") };

const view = new DataView(new ArrayBuffer(8));

function double(bits) {
  view.setBigUint64(0, BigInt("0x" + bits));
  return view.getFloat64(0);
}

function single(bits) {
  view.setUint32(0, Number("0x" + bits));
  return view.getFloat32(0);
}

function bits(number) {
  view.setFloat64(0, number);
  return view.getBigUint64(0).toString(16).padStart(16, "0");
}

function givenNumbers(vectors, testCase) {
  const { ticks, seconds, substeps, damping } = vectors.integrators[testCase.integrator];
  const { push, doublings } = testCase.push ? testCase : NO_PUSH;
  const { moments, frame } = vectors.inertias[testCase.inertia] ?? NO_INERTIA;
  return [
    ...vectors.starts[testCase.start].verbatim.map(single),
    ...vectors.gravities[testCase.gravity].gravity.map(double),
    ticks,
    seconds,
    substeps,
    ...damping.map(single),
    ...moments.map(single),
    ...frame.map(single),
    ...push,
    doublings,
  ];
}

function predicted(module, vectors, testCase) {
  givenNumbers(vectors, testCase).forEach((number, index) => module.give(index, number));
  if (module.predict(LAWS.indexOf(testCase.law), testCase.elapsed) !== 1) {
    return ["refused"];
  }
  return testCase.end.map((_, index) => bits(module.result(index)));
}

const vectorsFile = new URL("../../spec/vectors/reckoning.json", import.meta.url);
const vectors = JSON.parse(await readFile(vectorsFile, "utf8"));
const { instance } = await WebAssembly.instantiate(await readFile(process.argv[2]));

let [passed, failed] = [0, 0];
for (const section of ["predictions", "tumblings"]) {
  vectors[section].forEach((testCase, index) => {
    const end = predicted(instance.exports, vectors, testCase);
    if (end.join() === testCase.end.join()) {
      passed += 1;
    } else {
      failed += 1;
      console.log(`${section} ${index}: expected ${testCase.end}, got ${end}`);
    }
  });
}
console.log(`${passed} passed, ${failed} failed`);
process.exitCode = failed === 0 ? 0 : 1;
