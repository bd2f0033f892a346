#!/usr/bin/env bash
# A path of orientations that ends: what is the angular velocity after its end?
# PyPI drake 1.51.1: PiecewiseQuaternionSlerp and PiecewisePose over the same two samples, asked one second later.
# Guess: both stand at the last sample, and both say 0 rad/s.
# Seen: both stand. PiecewisePose says 0. PiecewiseQuaternionSlerp still says 1 rad/s, before its start too, so whoever
# extrapolates with its velocity turns a body that stands.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet --disable-pip-version-check drake==1.51.1
"$work/python/bin/python" - <<'PYTHON'
import importlib.metadata

import numpy
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.trajectories import PiecewisePose, PiecewiseQuaternionSlerp

print("drake", importlib.metadata.version("drake"))
turned = RotationMatrix.MakeZRotation(1.0)
slerp = PiecewiseQuaternionSlerp([0.0, 1.0], [Quaternion(1, 0, 0, 0), turned.ToQuaternion()])
pose = PiecewisePose.MakeLinear([0.0, 1.0], [RigidTransform(), RigidTransform(turned, [0, 0, 0])])


def angle(rotation):
    return float(numpy.arctan2(rotation[1, 0], rotation[0, 0]))


found = {}
for time in (-1.0, 0.5, 2.0):
    at = RotationMatrix(slerp.orientation(time)).matrix()
    rates = float(slerp.angular_velocity(time)[2]), float(pose.GetVelocity(time)[2])
    found[time] = (angle(at), angle(pose.GetPose(time).rotation().matrix()), *rates)
    print(f"t = {time}: angles {found[time][0]:.3f} and {found[time][1]:.3f} rad, rates {rates[0]:.3f} and {rates[1]:.3f} rad/s")
wanted = {-1.0: (0, 0, 1, 0), 0.5: (0.5, 0.5, 1, 1), 2.0: (1, 1, 1, 0)}
if not all(numpy.allclose(found[time], wanted[time], atol=1e-9) for time in wanted):
    raise SystemExit("changed: outside of its samples a path says something else")
print("as found: the slerp stands at its end and says that it turns at 1 rad/s")
PYTHON
