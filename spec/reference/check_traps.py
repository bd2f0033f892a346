"""Compiles the formulas of the traps with good and bad settings: the vectors must name the trap of each bad one.

Usage: python3 check_traps.py [-v]. A compiler that is not installed is left out, and so is a setting that this processor lacks.
Prints failures, then a count; the exit code is 1 after a failure. `-v` prints what each setting breaks.
"""

import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import check_reckoning

HERE = Path(__file__).resolve().parent
FUSED = "fused multiply-add"
CPP = ["c++", "-O2", str(HERE / "traps.cpp"), "-o"]
GO = ["go", "build", "-o"]
# A compiler's command with its settings, its environment, and the traps that it must fall into. Settings that break much
# may break more than that.
SETTINGS = [
    ([*CPP], ["-ffp-contract=off"], {}, set()),
    ([*CPP], ["-ffp-contract=off", "-march=haswell"], {}, set()),
    ([*CPP], ["-ffp-contract=fast", "-march=haswell"], {}, {FUSED}),
    ([*CPP], ["-ffast-math", "-march=haswell"], {}, {FUSED, "subnormal flushed to zero"}),
    ([*CPP], ["-ffp-contract=off", "-mfpmath=387"], {}, {"extended precision"}),
    ([*GO], [], {"GOAMD64": "v3"}, {FUSED}),
]
MUCH = {"-ffast-math", "-mfpmath=387"}


def compiled(command, settings, environment, folder):
    """The program, or None if the compiler is missing or does not know a setting."""
    if shutil.which(command[0]) is None:
        return None
    program = folder / "traps"
    source = [str(HERE / "traps.go")] if command[0] == "go" else []
    home = {"GOCACHE": str(folder / "cache"), "GOFLAGS": "-mod=mod", "GO111MODULE": "off"} if command[0] == "go" else {}
    made = subprocess.run([*command, str(program), *settings, *source], env=os.environ | home | environment, capture_output=True, text=True)
    if made.returncode:
        print(f"{command[0]} {' '.join(settings)}: {made.stderr.strip()[:300]}")
        return None
    return program


def results(program, cases):
    lines = "".join(" ".join([case["formula"].replace(" ", ""), *case["operands"]]) + "\n" for case in cases)
    done = subprocess.run([str(program)], input=lines, capture_output=True, text=True, check=True)
    return [f"{int(digits, 16):016x}" for digits in done.stdout.split()]


def fallen_into(program, cases):
    """The names of the traps, and the results that no trap explains."""
    traps, unexplained = set(), []
    for case, result in zip(cases, results(program, cases), strict=True):
        if result != case["result"][0]:
            wrong = dict(zip(case["wrong"], case["traps"]))
            traps.add(wrong.get(result))
            unexplained += [] if result in wrong else [f"{case['formula']} is {result}"]
    return traps - {None}, unexplained


def has_fma():
    """True if the programs for newer processors run here."""
    try:
        return " fma " in Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return False


def main():
    cases = json.loads((check_reckoning.SPEC / "vectors" / "reckoning.json").read_text(encoding="utf-8"))["traps"]
    passed, failed, left_out = 0, 0, 0
    for command, settings, environment, expected in SETTINGS:
        name = " ".join([command[0], *settings, *(f"{name}={value}" for name, value in environment.items())])
        newer = "-march=haswell" in settings or environment.get("GOAMD64") == "v3"
        with tempfile.TemporaryDirectory() as folder:
            runs = platform.machine() == "x86_64" and (has_fma() or not newer)
            program = compiled(command, settings, environment, Path(folder)) if runs else None
            if program is None:
                left_out += 1
                continue
            traps, unexplained = fallen_into(program, cases)
        good = traps >= expected if MUCH.intersection(settings) else traps == expected and not unexplained
        passed, failed = passed + good, failed + (not good)
        if not good or "-v" in sys.argv:
            print(f"{name}: {', '.join(sorted(traps)) or 'no trap'}{'; ' if unexplained else ''}{'; '.join(unexplained)}; expected {', '.join(sorted(expected)) or 'none'}")
    print(f"{passed} settings passed, {failed} failed, {left_out} left out")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
