#!/usr/bin/env bash
# A box with three different moments of inertia spins freely about nearly its middle axis.
# npm @babylonjs/havok 1.3.14, without a renderer; damping set to 0.
# Guess: Havok integrates the gyroscopic term, so the box turns over within some seconds and keeps its energy within 5 %.
# Seen: the angular velocity is the same after ten seconds, to six digits. There is no gyroscopic term, and no call to
# have one: angular momentum turns with the body. Predictors of torque-free rotation miss every such body.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
npm install --silent --no-audit --no-fund --prefix "$work" @babylonjs/havok@1.3.14
cat >"$work/run.mjs" <<'SCRIPT'
import { readFileSync } from "node:fs";
import HavokPhysics from "@babylonjs/havok";

const folder = new URL("node_modules/@babylonjs/havok/", import.meta.url);
const havok = await HavokPhysics({ wasmBinary: readFileSync(new URL("lib/esm/HavokPhysics.wasm", folder)) });
console.log("havok", JSON.parse(readFileSync(new URL("package.json", folder))).version);

const world = havok.HP_World_Create()[1];
havok.HP_World_SetGravity(world, [0, 0, 0]);
const shape = havok.HP_Shape_CreateBox([0, 0, 0], [0, 0, 0, 1], [1, 0.2, 0.5])[1];
const body = havok.HP_Body_Create()[1];
havok.HP_Body_SetShape(body, shape);
havok.HP_Body_SetMotionType(body, havok.MotionType.DYNAMIC);
havok.HP_Body_SetMassProperties(body, havok.HP_Shape_BuildMassProperties(shape)[1]);
havok.HP_Body_SetAngularDamping(body, 0);
havok.HP_World_AddBody(world, body, false);
const moments = havok.HP_Body_GetMassProperties(body)[1][2];
console.log("moments of inertia", moments.map((moment) => moment.toFixed(4)).join(" "));
havok.HP_Body_SetAngularVelocity(body, [0.05, 0.05, 5]);
const spin = () => [...havok.HP_Body_GetAngularVelocity(body)[1]];
const before = spin();
for (let second = 1; second <= 10; second += 1) {
    for (let step = 0; step < 60; step += 1) havok.HP_World_Step(world, 1 / 60);
}
const after = spin();
console.log("spin before", before.join(" "));
console.log("spin after 10 s", after.join(" "));
const different = new Set(moments.map((moment) => moment.toFixed(4))).size === 3;
if (!different || after.some((value, i) => Math.abs(value - before[i]) > 1e-3)) {
    console.log("changed: the spin is no longer constant");
    process.exit(1);
}
console.log("as found: a free body about its middle axis keeps its spin for ever");
SCRIPT
node "$work/run.mjs"
