"""Records 60 tumbling boxes in MuJoCo as an .npz: mujoco_boxes.py OUT [SECONDS]. Needs mujoco and numpy."""

import sys

import mujoco
import numpy as np

rng = np.random.default_rng(1)
half = rng.uniform(0.1, 0.4, (60, 3))
bodies = "".join(
    f'<body pos="{3 * (i % 10)} {3 * (i // 10)} 60"><freejoint/><geom type="box" size="{x} {y} {z}" contype="0"/></body>'
    for i, (x, y, z) in enumerate(half)
)
model = mujoco.MjModel.from_xml_string(f'<mujoco><option timestep="{1 / 60}"/><worldbody>{bodies}</worldbody></mujoco>')
data = mujoco.MjData(model)
data.qvel = np.concatenate([rng.uniform(-2, 2, (60, 3)), rng.uniform(-6, 6, (60, 3))], axis=1).ravel()

# The recorder.
qpos, qvel = [], []
for _ in range(int(60 * float(sys.argv[2] if len(sys.argv) > 2 else 3))):
    mujoco.mj_step(model, data)
    qpos.append(data.qpos.copy())
    qvel.append(data.qvel.copy())
np.savez(
    sys.argv[1],
    qpos=qpos,
    qvel=qvel,
    timestep=model.opt.timestep,
    gravity=model.opt.gravity,
    half_extents=model.geom_size,
    inertia=model.body_inertia[1:],
)
