// Records 60 tumbling boxes in Jolt: node jolt_boxes.mjs OUT.rhtrace [SECONDS]. Needs npm jolt-physics.
import initJolt from "jolt-physics";
import { Trace, boxes } from "./rhtrace.mjs";

const Jolt = await initJolt();
const settings = new Jolt.JoltSettings();
// One layer, whose bodies do not touch each other.
const [pairs, layers] = [new Jolt.ObjectLayerPairFilterTable(1), new Jolt.BroadPhaseLayerInterfaceTable(1, 1)];
layers.MapObjectToBroadPhaseLayer(0, new Jolt.BroadPhaseLayer(0));
settings.mObjectLayerPairFilter = pairs;
settings.mBroadPhaseLayerInterface = layers;
settings.mObjectVsBroadPhaseLayerFilter = new Jolt.ObjectVsBroadPhaseLayerFilterTable(layers, 1, pairs, 1);
const jolt = new Jolt.JoltInterface(settings);
const system = jolt.GetPhysicsSystem();
const bodies = boxes().map(({ half, at, linear, angular }) => {
  const shape = new Jolt.BoxShape(new Jolt.Vec3(...half));
  const created = new Jolt.BodyCreationSettings(
    shape, new Jolt.RVec3(...at), new Jolt.Quat(0, 0, 0, 1), Jolt.EMotionType_Dynamic, 0);
  created.mLinearVelocity = new Jolt.Vec3(...linear);
  created.mAngularVelocity = new Jolt.Vec3(...angular);
  const body = system.GetBodyInterface().CreateBody(created);
  system.GetBodyInterface().AddBody(body.GetID(), Jolt.EActivation_Activate);
  return { body, half, created };
});

// The recorder.
const xyz = (of) => [of.GetX(), of.GetY(), of.GetZ()];
const engine = { hertz: 60, gravity: xyz(system.GetGravity()), formula: 2 };
const known = bodies.map(({ half, created }) => ({
  half, damping: [created.mLinearDamping, created.mAngularDamping], gyroscopic: created.mApplyGyroscopicForce }));
const trace = new Trace(engine, known);
for (let tick = 0; tick < 60 * (process.argv[3] ?? 3); tick++) {
  jolt.Step(1 / 60, 1);
  trace.frame(bodies.map(({ body }) => {
    const turn = body.GetRotation();
    return [...xyz(body.GetPosition()), ...xyz(turn), turn.GetW(), ...xyz(body.GetLinearVelocity()), ...xyz(body.GetAngularVelocity())];
  }));
}
trace.write(process.argv[2]);
