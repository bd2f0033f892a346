#!/usr/bin/env bash
# A hollow ball of MuJoCo: a sphere with shellinertia="true", so that its density counts for the surface.
# PyPI newton 1.8.0 with warp-lang 1.19.0, ModelBuilder.add_mjcf; beside it mujoco 4.0.0.
# Guess: Newton, which hands models to MuJoCo, weighs it as MuJoCo does, or says that it cannot.
# Seen: MuJoCo has 3141.6 kg and a moment of 523.6 kg m2. Newton makes a solid ball, with no warning: 523.6 kg and
# 52.4 kg m2, a sixth and a tenth.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet --disable-pip-version-check newton==1.8.0 warp-lang==1.19.0 mujoco==4.0.0 mujoco-core==4.0.0
"$work/python/bin/python" - <<'PYTHON'
import importlib.metadata
import math
import warnings

import mujoco
import newton
import warp

warp.config.quiet = True
for package in ("newton", "warp-lang", "mujoco"):
    print(package, importlib.metadata.version(package))
ball = (
    '<mujoco model="m"><worldbody><body name="b"><freejoint/>'
    '<geom type="sphere" size="0.5" shellinertia="true"/></body></worldbody></mujoco>'
)
own = mujoco.MjModel.from_xml_string(ball)
found = {"mujoco": (float(own.body_mass[1]), float(own.body_inertia[1][0]))}
builder = newton.ModelBuilder()
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    builder.add_mjcf(ball)
found["newton"] = (float(builder.body_mass[0]), float(builder.body_inertia[0][0, 0]))
for name, (mass, moment) in found.items():
    print(f"{name}: {mass:.1f} kg, {moment:.1f} kg m2")
print("warnings:", *[str(one.message) for one in said], len(said))
shell, solid = 1000 * math.pi, 1000 * math.pi / 6
wanted = {"mujoco": (shell, shell / 6), "newton": (solid, solid / 10)}
right = all(math.isclose(a, b, rel_tol=1e-3) for name in found for a, b in zip(found[name], wanted[name]))
if not right or said:
    raise SystemExit("changed: Newton weighs shells, or says that it cannot")
print("as found: a shell for MuJoCo is a solid ball for Newton, with a sixth of its mass")
PYTHON
