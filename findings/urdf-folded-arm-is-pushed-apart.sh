#!/usr/bin/env bash
# One URDF, a folded arm whose first and third link overlap, without gravity, for one second.
# PyPI mujoco 4.0.0 and pybullet 3.2.7 (Linux, Python 3.11, whose wheel the latter has).
# Guess: it stands still in both: the format has no word for contacts among a robot's own links, and readers leave them out.
# Seen: MuJoCo finds one contact and pushes the hand out by 0.9 m; only a link and its parent are let through each other.
# PyBullet leaves the arm where it is, and does as MuJoCo only with URDF_USE_SELF_COLLISION.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet --disable-pip-version-check mujoco==4.0.0 pybullet==3.2.7
cd "$work"
python/bin/python - <<'PYTHON'
import importlib.metadata
import sys

import mujoco
import pybullet

INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
BALL = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
ARM = f"""<robot name="folded">
<link name="base">{INERTIAL}{BALL}</link><link name="arm">{INERTIAL}</link><link name="hand">{INERTIAL}{BALL}</link>
<joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/></joint>
<joint name="slide" type="prismatic"><parent link="arm"/><child link="hand"/><origin xyz="0.15 0 0"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
with open("folded.urdf", "w") as file:
    file.write(ARM)


def in_mujoco():
    model = mujoco.MjModel.from_xml_path("folded.urdf")
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    while data.time < 1:
        mujoco.mj_step(model, data)
    return data.joint("slide").qpos[0]


def in_pybullet(flags):
    pybullet.connect(pybullet.DIRECT)
    arm = pybullet.loadURDF("folded.urdf", useFixedBase=True, flags=flags)
    for joint in range(2):
        pybullet.setJointMotorControl2(arm, joint, pybullet.VELOCITY_CONTROL, force=0)
    for _ in range(240):
        pybullet.stepSimulation()
    slide = pybullet.getJointState(arm, 1)[0]
    pybullet.disconnect()
    return slide


found = in_mujoco(), in_pybullet(0), in_pybullet(pybullet.URDF_USE_SELF_COLLISION)
print("mujoco", importlib.metadata.version("mujoco"), "slides by", found[0])
print("pybullet", importlib.metadata.version("pybullet"), "slides by", found[1], "and with self-collision by", found[2])
if not (found[0] > 0.5 and found[1] == 0 and found[2] > 0.5):
    print("changed: the readers agree, or differ otherwise")
    sys.exit(1)
print("as found: the same file is at rest in one engine and flies apart in the other")
PYTHON
