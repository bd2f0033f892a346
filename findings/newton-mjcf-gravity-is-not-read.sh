#!/usr/bin/env bash
# A scene file of MuJoCo on the moon: <option gravity="0 0 -1.62"/>.
# PyPI newton 1.8.0 with warp-lang 1.19.0 on the processor, ModelBuilder.add_mjcf.
# Guess: the model gets the gravity of its file; a gravity of the builder's constructor gives way.
# Seen: the builder keeps -9.81, with no warning, as if the option were not there. Only the flag that switches gravity
# off altogether is read: <flag gravity="disable"/> gives 0.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet --disable-pip-version-check newton==1.8.0 warp-lang==1.19.0
"$work/python/bin/python" - <<'PYTHON'
import importlib.metadata
import warnings

import newton
import warp

warp.config.quiet = True
for package in ("newton", "warp-lang"):
    print(package, importlib.metadata.version(package))


def gravity(option):
    scene = (
        f'<mujoco model="moon">{option}<worldbody><body name="b"><freejoint/>'
        '<geom type="sphere" size="0.5"/></body></worldbody></mujoco>'
    )
    builder = newton.ModelBuilder()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        builder.add_mjcf(scene)
    found = float(builder.gravity[2])
    print(f"{option}: {found:.2f} m/s2, {len(said)} warnings", *[str(one.message) for one in said])
    return found, len(said)


moon, said = gravity('<option gravity="0 0 -1.62"/>')
off, _ = gravity('<option><flag gravity="disable"/></option>')
if abs(moon + 9.81) > 1e-4 or said or abs(off) > 1e-6:
    raise SystemExit("changed: the gravity of the file counts, or its absence is said")
print("as found: a scene on the moon falls with the gravity of the earth")
PYTHON
