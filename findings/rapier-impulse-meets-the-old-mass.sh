#!/usr/bin/env bash
# A collider of a Rapier body gets another mass, and an impulse follows before the next step.
# npm @dimforge/rapier3d-compat 0.21.0.
# Guess: setMass is seen at once by mass() and by the impulse: 10 N s on 10 kg give 1 m/s.
# Seen: mass() stays 1 kg until the next step, and so does the mass that the impulse meets: 10 m/s. The step then
# takes the new mass and keeps the speed. recomputeMassPropertiesFromColliders() in between gives 1 m/s.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
npm install --silent --no-audit --no-fund --prefix "$work" @dimforge/rapier3d-compat@0.21.0
cat >"$work/run.mjs" <<'SCRIPT'
import { readFileSync } from "node:fs";
import RAPIER from "@dimforge/rapier3d-compat";

await RAPIER.init();
const about = new URL("node_modules/@dimforge/rapier3d-compat/package.json", import.meta.url);
console.log("rapier", JSON.parse(readFileSync(about)).version);

function pushed(recompute) {
    const world = new RAPIER.World({ x: 0, y: 0, z: 0 });
    const body = world.createRigidBody(RAPIER.RigidBodyDesc.dynamic());
    const collider = world.createCollider(RAPIER.ColliderDesc.ball(0.5).setMass(1), body);
    world.step();
    collider.setMass(10);
    if (recompute) body.recomputeMassPropertiesFromColliders();
    const mass = body.mass();
    body.applyImpulse({ x: 10, y: 0, z: 0 }, true);
    world.step();
    console.log(recompute ? "recomputed:" : "as it comes:", "mass", mass, "kg before the step,", body.mass(), "after;", "speed", body.linvel().x);
    return [mass, body.mass(), body.linvel().x];
}

const near = (found, wanted) => found.every((value, i) => Math.abs(value - wanted[i]) < 1e-5);
if (!near(pushed(false), [1, 10, 10]) || !near(pushed(true), [10, 10, 1])) {
    console.log("changed: the new mass counts at another moment");
    process.exit(1);
}
console.log("as found: the impulse meets the mass of the last step, so the body is ten times too fast");
SCRIPT
node "$work/run.mjs"
