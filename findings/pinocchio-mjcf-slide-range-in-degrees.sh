#!/usr/bin/env bash
# A robot file of MuJoCo with a lift: a slide joint with range="-1 2", which MuJoCo reads as metres.
# PyPI pin 4.1.0 (Pinocchio), buildModelFromMJCF; beside it PyPI mujoco 4.0.0.
# Guess: the lift goes from -1 m to 2 m in both.
# Seen: Pinocchio turns the range from degrees into radians, as for a hinge: -0.017 m to 0.035 m, with no warning. With
# <compiler angle="radian"/> the same line gives -1 m to 2 m.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet --disable-pip-version-check pin==4.1.0 mujoco==4.0.0 mujoco-core==4.0.0
"$work/python/bin/python" - <<'PYTHON'
import math
import tempfile

import mujoco
import pinocchio

print("pinocchio", pinocchio.__version__, "mujoco", mujoco.__version__)


def ranges(compiler):
    model = (
        f'<mujoco model="lift">{compiler}<worldbody><body name="cabin">'
        '<joint name="lift" type="slide" axis="0 0 1" limited="true" range="-1 2"/>'
        '<geom type="box" size="0.1 0.2 0.3"/></body></worldbody></mujoco>'
    )
    with tempfile.NamedTemporaryFile("w", suffix=".xml") as file:
        file.write(model)
        file.flush()
        found = pinocchio.buildModelFromMJCF(file.name)
    theirs = [float(found.lowerPositionLimit[0]), float(found.upperPositionLimit[0])]
    own = [float(value) for value in mujoco.MjModel.from_xml_string(model).jnt_range[0]]
    print(compiler or "(no compiler element)", "mujoco", own, "pinocchio", theirs)
    return own, theirs


def near(found, wanted):
    return all(math.isclose(a, b, abs_tol=1e-6) for a, b in zip(found, wanted))


own, theirs = ranges("")
radians_own, radians = ranges('<compiler angle="radian"/>')
right = near(own, [-1, 2]) and near(radians_own, [-1, 2])
if not (right and near(theirs, [math.radians(-1), math.radians(2)]) and near(radians, [-1, 2])):
    raise SystemExit("changed: the range of a slide is read in another way")
print("as found: a slide of three metres becomes one of five centimetres")
PYTHON
