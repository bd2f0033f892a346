#!/usr/bin/env bash
# A planar joint of URDF with <axis xyz="1 0 0"/>: the child moves in the plane across the x axis.
# PyPI pin 4.1.0 (Pinocchio), drake 1.51.1, dartpy 6.20.0: one file, the first two coordinates set to 0.5 and 0.25.
# Guess: the child moves in the y-z plane in all three; how the two coordinates lie in it may differ.
# Seen: Pinocchio ignores the axis and moves it in x and y, out of the plane of the file. Drake moves it by 0.25 along y
# and -0.5 along z, DART by 0.5 along y and 0.25 along z. Three places for one file, and no warning.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet --disable-pip-version-check pin==4.1.0 drake==1.51.1 dartpy==6.20.0
"$work/python/bin/python" - <<'PYTHON'
import importlib.metadata
import pathlib
import tempfile

import dartpy
import numpy
import pinocchio
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

for package in ("pin", "drake", "dartpy"):
    print(package, importlib.metadata.version(package))
inertial = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
robot = (
    f'<robot name="r"><link name="a">{inertial}</link><link name="b">{inertial}</link>'
    '<joint name="j" type="planar"><parent link="a"/><child link="b"/><axis xyz="1 0 0"/></joint></robot>'
)

model = pinocchio.buildModelFromXML(robot)
data, q = model.createData(), pinocchio.neutral(model)
q[:2] = [0.5, 0.25]
pinocchio.forwardKinematics(model, data, q)
found = {"pinocchio": data.oMi[1].translation}

plant = MultibodyPlant(0.01)
Parser(plant).AddModelsFromString(robot, "urdf")
plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("a"))
plant.Finalize()
context = plant.CreateDefaultContext()
plant.SetPositions(context, [0.5, 0.25, 0.0])
found["drake"] = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("b")).translation()

with tempfile.TemporaryDirectory() as folder:
    path = pathlib.Path(folder, "r.urdf")
    path.write_text(robot)
    loader = dartpy.utils.DartLoader() if hasattr(dartpy.utils, "DartLoader") else dartpy.io.DartLoader()
    skeleton = loader.parseSkeleton(str(path))
positions = numpy.zeros(skeleton.getNumDofs())
positions[-3:] = [0.5, 0.25, 0.0]
skeleton.setPositions(positions)
found["dart"] = skeleton.getBodyNode("b").getTransform().translation()

wanted = {"pinocchio": [0.5, 0.25, 0], "drake": [0, 0.25, -0.5], "dart": [0, 0.5, 0.25]}
for name, place in found.items():
    print(name, "moves the child to", numpy.round(place, 6).tolist())
if not all(numpy.allclose(found[name], place, atol=1e-9) for name, place in wanted.items()):
    raise SystemExit("changed: a planar joint moves in another way")
print("as found: one planar joint, three places, one of them outside its plane")
PYTHON
