"""Records 60 tumbling boxes in Newton, on the CPU, as an .npz: newton_boxes.py OUT [SECONDS]. Needs newton and numpy."""

import sys

import newton
import numpy as np
import warp as wp

rng = np.random.default_rng(1)
half = rng.uniform(0.1, 0.4, (60, 3))
builder = newton.ModelBuilder()
for i, size in enumerate(half):
    body = builder.add_body(xform=wp.transform((3.0 * (i % 10), 3.0 * (i // 10), 60.0), wp.quat_identity()))
    builder.add_shape_box(body, hx=size[0], hy=size[1], hz=size[2])
model = builder.finalize(device="cpu")
solver = newton.solvers.SolverXPBD(model)
states = model.state(), model.state()
states[0].body_qd.assign(np.concatenate([rng.uniform(-2, 2, (60, 3)), rng.uniform(-6, 6, (60, 3))], axis=1))

# The recorder.
poses, velocities = [], []
for _ in range(int(60 * float(sys.argv[2] if len(sys.argv) > 2 else 3))):
    states[0].clear_forces()
    solver.step(states[0], states[1], None, None, 1 / 60)
    states = states[::-1]
    poses.append(states[0].body_q.numpy().copy())
    velocities.append(states[0].body_qd.numpy().copy())
poses, velocities = np.array(poses), np.array(velocities)
np.savez(
    sys.argv[1],
    timestep=1 / 60,
    position=poses[:, :, :3],
    quat_xyzw=poses[:, :, 3:],
    linear=velocities[:, :, :3],
    angular=velocities[:, :, 3:],
    gravity=model.gravity.numpy().reshape(-1, 3)[0],
    half_extents=half,
    inertia=[np.diag(inertia) for inertia in model.body_inertia.numpy()],
)
