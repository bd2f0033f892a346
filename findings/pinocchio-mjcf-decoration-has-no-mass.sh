#!/usr/bin/env bash
# A body of MuJoCo with two geoms, one of which touches nothing (contype and conaffinity 0), as decoration has it.
# PyPI pin 4.1.0 (Pinocchio), buildModelFromMJCF; beside it PyPI mujoco 4.0.0.
# Guess: both weigh it, since only <compiler discardvisual> or inertiagrouprange say otherwise: 571.6 kg.
# Seen: Pinocchio leaves out a geom whose two contact masks are both 0, also where it states its own mass: 48 kg. One
# mask that is not 0 brings the 523.6 kg back. No warning.
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


def masses(attributes):
    model = (
        '<mujoco model="m"><worldbody><body name="b"><freejoint/><geom type="box" size="0.1 0.2 0.3"/>'
        f'<geom type="sphere" size="0.5" {attributes}/></body></worldbody></mujoco>'
    )
    with tempfile.NamedTemporaryFile("w", suffix=".xml") as file:
        file.write(model)
        file.flush()
        theirs = sum(inertia.mass for inertia in pinocchio.buildModelFromMJCF(file.name).inertias)
    own = float(mujoco.MjModel.from_xml_string(model).body_mass.sum())
    print(f"{attributes or '(as it comes)'}: mujoco {own:.1f} kg, pinocchio {theirs:.1f} kg")
    return own, theirs


both = 48 + 1000 * 4 / 3 * math.pi * 0.5**3
wanted = {
    "": (both, both),
    'contype="0"': (both, both),
    'contype="0" conaffinity="0"': (both, 48),
    'contype="0" conaffinity="0" mass="5"': (53, 48),
}
for attributes, masses_wanted in wanted.items():
    if not all(math.isclose(a, b, rel_tol=1e-4) for a, b in zip(masses(attributes), masses_wanted)):
        raise SystemExit(f"changed: another mass with {attributes}")
print("as found: what touches nothing weighs nothing in Pinocchio, and all of its mass in MuJoCo")
PYTHON
