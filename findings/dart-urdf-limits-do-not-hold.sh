#!/usr/bin/env bash
# A robot file with a revolute joint whose limits are -1 and 2 rad.
# PyPI dartpy 6.20.0 (DART), DartLoader and World.step.
# Guess: a link that starts at 2 rad/s stops at 2 rad.
# Seen: the limits are read, and getPositionUpperLimit answers 2, but the link turns to 6 rad in 3 s. Nothing holds them
# until setLimitEnforcement(True) is called for each joint; then it stays within.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet --disable-pip-version-check dartpy==6.20.0
"$work/python/bin/python" - <<'PYTHON'
import importlib.metadata
import pathlib
import tempfile

import dartpy
import numpy

print("dartpy", importlib.metadata.version("dartpy"))
inertial = '<inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
robot = (
    f'<robot name="r"><link name="world"/><link name="b">{inertial}</link>'
    '<joint name="j" type="revolute"><parent link="world"/><child link="b"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="2" effort="10" velocity="3"/></joint></robot>'
)


def turned(enforced):
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, "r.urdf")
        path.write_text(robot)
        loader = dartpy.utils.DartLoader() if hasattr(dartpy.utils, "DartLoader") else dartpy.io.DartLoader()
        skeleton = loader.parseSkeleton(str(path))
    world = dartpy.simulation.World()
    world.setGravity([0, 0, 0])
    world.setTimeStep(1 / 240)
    joint = skeleton.getJoint(skeleton.getNumJoints() - 1)
    if enforced:
        joint.setLimitEnforcement(True)
    world.addSkeleton(skeleton)
    velocities = numpy.zeros(skeleton.getNumDofs())
    velocities[-1] = 2.0
    skeleton.setVelocities(velocities)
    for _ in range(3 * 240):
        world.step()
    angle, limit = float(skeleton.getPositions()[-1]), joint.getPositionUpperLimit(0)
    print(f"enforced: {joint.areLimitsEnforced()}; upper limit {limit} rad, angle after 3 s {angle:.3f} rad")
    return angle, limit


angle, limit = turned(False)
held, _ = turned(True)
if not (limit == 2.0 and abs(angle - 6.0) < 1e-3 and held < 2.1):
    raise SystemExit("changed: limits of a file hold, or setLimitEnforcement does not")
print("as found: a joint goes three times as far as its file allows")
PYTHON
