// Checks predictors and codec, compiled to WebAssembly, against the golden vectors, bit for bit.
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

/** The outcomes of the codec, in the order of their numbers. */
const OUTCOMES = ["refused", "accepted", "skipped", "answered by an error", "accepted, but changed"];

function given(digits) {
  const bytes = Buffer.from(digits, "hex");
  const { buffer, memory } = instance.exports;
  const place = buffer(bytes.length);
  new Uint8Array(memory.buffer, place, bytes.length).set(bytes);
}

function expect(name, expected, outcome) {
  if (expected.includes(OUTCOMES[outcome])) {
    passed += 1;
  } else {
    failed += 1;
    console.log(`${name}: ${OUTCOMES[outcome]}, expected ${expected.join(" or ")}`);
  }
}

const read = async (name) => JSON.parse(await readFile(new URL(`../../spec/vectors/${name}.json`, import.meta.url)));
const { message, packet } = instance.exports;
const control = await read("control");
for (const [side, name] of ["client", "server"].entries()) {
  for (const line of control[`${name} messages`]) {
    given(line.bytes);
    // A number out of range is found when the command is checked, or when it is decoded.
    const error = line.error === undefined ? ["accepted"] : ["accepted", "answered by an error"];
    expect(line.name, line.skipped === undefined ? error : ["skipped"], message(side));
  }
  for (const line of control[`refused ${name} messages`]) {
    given(line.bytes);
    expect(line.name, ["refused"], message(side));
  }
}
const [packets, scripted] = [await read("packets"), await read("scripted")];
for (const [lines, expected] of [[packets.accepted, "accepted"], [packets.refused, "refused"], [scripted.refused, "refused"]]) {
  for (const line of lines) {
    given(line.bytes);
    expect(line.name, [expected], packet());
  }
}
console.log(`${passed} passed, ${failed} failed`);
process.exitCode = failed === 0 ? 0 : 1;
