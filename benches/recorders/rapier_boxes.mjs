// Records 60 tumbling boxes in Rapier: node rapier_boxes.mjs OUT.rhtrace [SECONDS]. Needs npm @dimforge/rapier3d-compat.
import RAPIER from "@dimforge/rapier3d-compat";
import { Trace, boxes } from "./rhtrace.mjs";

await RAPIER.init();
const world = new RAPIER.World({ x: 0, y: -9.81, z: 0 });
world.timestep = 1 / 60;
const damping = [0.5, 0.8];
const of = ([x, y, z]) => ({ x, y, z });
const bodies = boxes().map(({ half, at, linear, angular }) => {
  const desc = RAPIER.RigidBodyDesc.dynamic().setTranslation(...at).setLinvel(...linear).setAngvel(of(angular));
  const body = world.createRigidBody(desc.setLinearDamping(damping[0]).setAngularDamping(damping[1]));
  world.createCollider(RAPIER.ColliderDesc.cuboid(...half).setCollisionGroups(0), body);
  return { body, half };
});

// The recorder.
const xyz = ({ x, y, z }) => [x, y, z];
const engine = { hertz: 60, substeps: world.numSolverIterations, gravity: xyz(world.gravity), formula: 0 };
world.step(); // Masses are computed by the first step.
const known = bodies.map(({ body, half }) => ({ half, damping, gyroscopic: true, moments: xyz(body.principalInertia()) }));
const trace = new Trace(engine, known);
for (let tick = 0; tick < 60 * (process.argv[3] ?? 3); tick++) {
  trace.frame(bodies.map(({ body }) => {
    const { x, y, z, w } = body.rotation();
    return [...xyz(body.translation()), x, y, z, w, ...xyz(body.linvel()), ...xyz(body.angvel())];
  }));
  world.step();
}
trace.write(process.argv[2]);
