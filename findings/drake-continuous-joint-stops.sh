#!/usr/bin/env bash
# A wheel: a continuous joint of URDF whose <limit> has lower and upper, as exporters write it.
# PyPI drake 1.51.1; beside it pin 4.1.0 (Pinocchio) and dartpy 6.20.0.
# Guess: lower and upper mean nothing for a continuous joint, so the wheel turns freely in all three.
# Seen: Pinocchio and DART have a joint without limits. Drake takes -1 and 2 rad as limits: a wheel that spins at
# 2 rad/s stands at 2 rad, and no warning is given.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet --disable-pip-version-check drake==1.51.1 pin==4.1.0 dartpy==6.20.0
"$work/python/bin/python" - <<'PYTHON'
import importlib.metadata
import math
import pathlib
import tempfile

import dartpy
import pinocchio
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

for package in ("drake", "pin", "dartpy"):
    print(package, importlib.metadata.version(package))
inertial = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
robot = (
    f'<robot name="r"><link name="a">{inertial}</link><link name="b">{inertial}</link>'
    '<joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="2" effort="10" velocity="3"/></joint></robot>'
)

model = pinocchio.buildModelFromXML(robot)
turns = model.nq == 2 and model.nv == 1
print("pinocchio: coordinates", model.nq, "(cosine and sine of any angle)")

with tempfile.TemporaryDirectory() as folder:
    path = pathlib.Path(folder, "r.urdf")
    path.write_text(robot)
    loader = dartpy.utils.DartLoader() if hasattr(dartpy.utils, "DartLoader") else dartpy.io.DartLoader()
    joint = loader.parseSkeleton(str(path)).getJoint(1)
free = [joint.getPositionLowerLimit(0), joint.getPositionUpperLimit(0)]
print("dart: limits", free)

builder = DiagramBuilder()
plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.001)
Parser(plant).AddModelsFromString(robot, "urdf")
plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("a"))
plant.Finalize()
simulator = Simulator(builder.Build())
context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
joint = plant.GetJointByName("j")
limits = [joint.position_lower_limit(), joint.position_upper_limit()]
joint.set_angular_rate(context, 2.0)
simulator.AdvanceTo(4.0)
angle, rate = joint.get_angle(context), joint.get_angular_rate(context)
print(f"drake: limits {limits}; after 4 s at 2 rad/s the wheel is at {angle:.3f} rad, {rate:.3f} rad/s")

if not (turns and free == [-math.inf, math.inf] and limits == [-1.0, 2.0] and angle < 2.1):
    raise SystemExit("changed: another of the three has limits, or Drake has none")
print("as found: the wheel turns for ever in two of them, and stops at 2 rad in Drake")
PYTHON
