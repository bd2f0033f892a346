// Checks the predictors, compiled to WebAssembly, against the golden vectors, bit for bit.
//
// Usage: node check.mjs MODULE.wasm. Prints failures, then a count; the exit code is 1 after a failure.

import { readFile } from "node:fs/promises";

const PREDICTORS = ["rest", "uniform", "ballistic", "torque_free", "ballistic_torque_free", "constant_acceleration"];
const NO_ACCELERATION = { acceleration: [0, 0, 0], exponent: 0 };
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
  const { acceleration, exponent } = testCase.acceleration ? testCase : NO_ACCELERATION;
  const { moments, frame } = vectors.inertias[testCase.inertia] ?? NO_INERTIA;
  return [
    ...vectors.initial_states[testCase.initial_state].body_state.map(single),
    ...vectors.gravities[testCase.gravity].gravity.map(double),
    ticks,
    seconds,
    substeps,
    ...damping.map(single),
    ...moments.map(single),
    ...frame.map(single),
    ...acceleration,
    exponent,
  ];
}

function predicted(module, vectors, testCase) {
  givenNumbers(vectors, testCase).forEach((number, index) => module.give(index, number));
  if (module.predict(PREDICTORS.indexOf(testCase.predictor), testCase.elapsed) !== 1) {
    return ["refused"];
  }
  return testCase.end.map((_, index) => bits(module.result(index)));
}

const vectorsFile = new URL("../../spec/vectors/reckoning.json", import.meta.url);
const vectors = JSON.parse(await readFile(vectorsFile, "utf8"));
const { instance } = await WebAssembly.instantiate(await readFile(process.argv[2]));

let [passed, failed] = [0, 0];
for (const section of ["predictions", "torque_free_rotations"]) {
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
