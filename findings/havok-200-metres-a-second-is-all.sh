#!/usr/bin/env bash
# A projectile of 1,000 m/s and a wheel of 200 rad/s in empty space.
# npm @babylonjs/havok 1.3.14, without a renderer; damping set to 0.
# Guess: both are kept, as no call of the interface sets or names a limit.
# Seen: the calls answer OK; velocities read back at once are 200 m/s and 100 rad/s (a little less after a step). The
# cut is by length: (300, 300, 0) keeps its direction. Nothing else says so.
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
const named = Object.keys(havok).filter((name) => /max.*velocity|velocity.*(limit|max)/i.test(name));
console.log("calls that name a limit:", named.length);

const world = havok.HP_World_Create()[1];
havok.HP_World_SetGravity(world, [0, 0, 0]);
const shape = havok.HP_Shape_CreateSphere([0, 0, 0], 0.5)[1];
function flying(linear, angular, height) {
    const body = havok.HP_Body_Create()[1];
    havok.HP_Body_SetShape(body, shape);
    havok.HP_Body_SetMotionType(body, havok.MotionType.DYNAMIC);
    havok.HP_Body_SetMassProperties(body, havok.HP_Shape_BuildMassProperties(shape)[1]);
    havok.HP_Body_SetLinearDamping(body, 0);
    havok.HP_Body_SetAngularDamping(body, 0);
    havok.HP_Body_SetQTransform(body, [[0, height, 0], [0, 0, 0, 1]]);
    havok.HP_World_AddBody(world, body, false);
    const answers = [havok.HP_Body_SetLinearVelocity(body, linear), havok.HP_Body_SetAngularVelocity(body, angular)];
    const read = () => [havok.HP_Body_GetLinearVelocity(body)[1], havok.HP_Body_GetAngularVelocity(body)[1]].map((v) => [...v]);
    const atOnce = read();
    havok.HP_World_Step(world, 1 / 60);
    const ok = answers.every((answer) => answer === havok.Result.RESULT_OK || answer.value === 0);
    console.log("asked", linear, angular, "answers", ok ? "OK" : answers, "read at once", atOnce, "after a step", read());
    return [ok, ...atOnce[0], ...atOnce[1]];
}
const near = (found, wanted) => found.every((value, i) => typeof value === "boolean" ? value : Math.abs(value - wanted[i]) < 0.01);
const fast = flying([1000, 0, 0], [0, 200, 0], 0);
const slant = flying([300, 300, 0], [60, 60, 0], 10);
const side = 200 / Math.sqrt(2);
if (named.length > 0 || !near(fast, [true, 200, 0, 0, 0, 100, 0]) || !near(slant, [true, side, side, 0, 60, 60, 0])) {
    console.log("changed: other limits, or they are named");
    process.exit(1);
}
console.log("as found: 200 m/s and 100 rad/s are the most, by length, and no answer says so");
SCRIPT
node "$work/run.mjs"
