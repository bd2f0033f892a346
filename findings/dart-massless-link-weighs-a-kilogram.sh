#!/usr/bin/env bash
# A link of URDF without <inertial>, as frames and sensors have it, at the end of an arm of one metre.
# PyPI dartpy 6.20.0 (DART); beside it pin 4.1.0 (Pinocchio) and drake 1.51.1.
# Guess: it weighs nothing, or the loader refuses it.
# Seen: 0 kg in Pinocchio and in Drake, 1 kg in DART, which is what its own default body weighs. A robot of 2 kg so has
# its centre a third of a metre further out, and no warning is given.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet --disable-pip-version-check dartpy==6.20.0 pin==4.1.0 drake==1.51.1
"$work/python/bin/python" - <<'PYTHON'
import importlib.metadata
import pathlib
import tempfile

import dartpy
import pinocchio
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

for package in ("dartpy", "pin", "drake"):
    print(package, importlib.metadata.version(package))
robot = (
    '<robot name="r"><link name="a"><inertial><mass value="2"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="sensor"/>'
    '<joint name="j" type="revolute"><parent link="a"/><child link="sensor"/><origin xyz="1 0 0"/>'
    '<axis xyz="0 0 1"/><limit lower="-1" upper="2" effort="10" velocity="3"/></joint></robot>'
)

model = pinocchio.buildModelFromXML(robot, pinocchio.JointModelFreeFlyer())
found = {"pinocchio": sum(inertia.mass for inertia in model.inertias)}

plant = MultibodyPlant(0.01)
Parser(plant).AddModelsFromString(robot, "urdf")
plant.Finalize()
found["drake"] = plant.CalcTotalMass(plant.CreateDefaultContext())

with tempfile.TemporaryDirectory() as folder:
    path = pathlib.Path(folder, "r.urdf")
    path.write_text(robot)
    loader = dartpy.utils.DartLoader() if hasattr(dartpy.utils, "DartLoader") else dartpy.io.DartLoader()
    skeleton = loader.parseSkeleton(str(path))
found["dart"] = skeleton.getMass()
centre = float(skeleton.getCOM()[0])

for name, mass in found.items():
    print(name, mass, "kg")
print(f"dart: centre of mass at x = {centre:.4f} m")
wanted = {"pinocchio": 2.0, "drake": 2.0, "dart": 3.0}
if any(abs(found[name] - mass) > 1e-9 for name, mass in wanted.items()) or abs(centre - 1 / 3) > 1e-6:
    raise SystemExit("changed: a link without inertial weighs something else")
print("as found: a link without mass weighs a kilogram in DART alone")
PYTHON
