"""Records 60 tumbling boxes in PyBullet as an .npz: pybullet_boxes.py OUT [SECONDS]. Needs pybullet and numpy."""

import sys

import numpy as np
import pybullet as p

p.connect(p.DIRECT)
p.setGravity(0, 0, -9.81)
p.setTimeStep(1 / 60)
rng = np.random.default_rng(1)
half = rng.uniform(0.1, 0.4, (60, 3))
bodies = []
for i, size in enumerate(half):
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=size)
    place = [3 * (i % 10), 3 * (i // 10), 60]
    # As a rigid body: a lone multibody is damped by 0.04 * (1 + speed), which no engine else does.
    body = p.createMultiBody(1, shape, basePosition=place, useMaximalCoordinates=True)
    p.setCollisionFilterGroupMask(body, -1, 0, 0)
    p.changeDynamics(body, -1, linearDamping=0.04, angularDamping=0.04)
    p.resetBaseVelocity(body, rng.uniform(-2, 2, 3), rng.uniform(-6, 6, 3))
    bodies.append(body)

# The recorder.
rows = []
for _ in range(int(60 * float(sys.argv[2] if len(sys.argv) > 2 else 3))):
    p.stepSimulation()
    rows.append([[*sum(p.getBasePositionAndOrientation(b), ()), *sum(p.getBaseVelocity(b), ())] for b in bodies])
rows = np.array(rows)
position, rotation, linear, angular = np.split(rows, [3, 7, 10], axis=2)
np.savez(
    sys.argv[1],
    timestep=1 / 60,
    position=position,
    quat_xyzw=rotation,
    linear=linear,
    angular=angular,
    gravity=[0, 0, -9.81],
    half_extents=half,
    inertia=[p.getDynamicsInfo(b, -1)[2] for b in bodies],
)
