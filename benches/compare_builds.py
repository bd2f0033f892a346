#!/usr/bin/env python3
"""Compares two builds side by side: instructions, times and bytes.

    python3 benches/compare_builds.py build OLD                      # another folder, at 2ebdc94d; then this checkout
    python3 benches/compare_builds.py measure OLD                    # all parts, some two hours on two shared cores
    python3 benches/compare_builds.py measure OLD --parts bytes,instructions
    rhumb-paper page docs/results/builds.md

`build` makes a work tree of the old commit, adds later Criterion benches as far as they compile there
(`benches/compare_builds.patch`), and builds both in release. `measure` writes `docs/results/data/builds.json`; parts that are
not named keep their rows.

- *instructions*: what callgrind (valgrind) counts within one function of a Criterion bench, 10,000 bodies. They repeat.
- *times*: medians of pairs, old new new old and so on; the ratio is the median of the pairs' ratios.
- *bytes*: one run of each build, as they repeat to the bit.
- *stages*: Criterion's means of each bench of both builds, as `cargo bench -- --save-baseline` leaves them.

On failure the exit code is 1, with a sentence on standard error.
"""

import argparse
import ctypes
import json
import os
import pathlib
import platform
import re
import shlex
import statistics
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
OLD_COMMIT = "2ebdc94d"
# The commit of the benches that the old one is given, and their files.
BENCHES_COMMIT = "5a6b92d1"
ADDED = [
    "benches/benches/stream.rs",
    "benches/benches/scene.rs",
    "benches/benches/support.rs",
    "benches/src/setup.rs",
    "benches/src/setup/decoding.rs",
]
OUT = ROOT / "docs/results/data/builds.json"
CUBES = ROOT / "docs/results/recordings/cubes_a.rhtrace.zst"
BENCHES = ["stream", "scene"]
# Tasks of `rhumb-bench` whose names have changed.
OLD_NAMES = {"load frames": "frames"}


class Failed(Exception):
    """A step that did not end well, with a sentence for the user."""


def call(command, **options):
    """Runs a command, and returns its output."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **options)
    if done.returncode != 0:
        tail = "\n".join((done.stdout + done.stderr).splitlines()[-8:])
        raise Failed(f"{shlex.join(str(word) for word in command)} ended with {done.returncode}:\n{tail}")
    return done.stdout


def build(old):
    """Makes the old work tree if it is not there, and builds both."""
    if not old.exists():
        call(["git", "-C", ROOT, "worktree", "add", "--detach", old, OLD_COMMIT])
        for place in ADDED:
            (old / place).parent.mkdir(parents=True, exist_ok=True)
            (old / place).write_text(call(["git", "-C", ROOT, "show", f"{BENCHES_COMMIT}:{place}"]))
        call(["git", "-C", old, "apply", ROOT / "benches/compare_builds.patch"])
    for folder in [old, ROOT]:
        packages = ["-p", "rhumb-bench", "-p", "rhumb-server"]
        command = ["cargo", "build", "--release", *packages, "--bins", "--benches"]
        for one in [command, ["bindings/web/build"]]:
            print(f"{folder}: {shlex.join(one)}", file=sys.stderr)
            subprocess.run(one, cwd=folder, check=True)
    subprocess.run(["cargo", "build", "--release", "-p", "rhumb-tests", "--bin", "rhumb-follow"], cwd=ROOT, check=True)


class Build:
    """A checkout with its release build."""

    def __init__(self, folder, is_old):
        self.folder, self.is_old = folder, is_old
        self.release = folder / "target/release"

    def bench(self, name):
        """The newest executable of a Criterion bench."""
        found = [path for path in (self.release / "deps").glob(f"{name}-*") if not path.suffix]
        if not found:
            raise Failed(f"{self.folder} has no bench {name}: run `build` first")
        return max(found, key=lambda path: path.stat().st_mtime)

    def task(self, arguments, result):
        """Runs a task of `rhumb-bench`, and returns the file that it writes."""
        for new, old in OLD_NAMES.items():
            if self.is_old and arguments.startswith(new):
                arguments = old + arguments.removeprefix(new)
        with tempfile.TemporaryDirectory() as out:
            words = shlex.split(arguments.replace("CUBES", str(CUBES)).replace("OUT", out))
            call([self.release / "rhumb-bench", *words, "--out", out], cwd=out)
            return json.loads((pathlib.Path(out) / result).read_text())

    def replay_of(self, scene, seconds, options):
        """Records a scene, and returns the summary of its replay."""
        with tempfile.TemporaryDirectory() as out:
            bench = self.release / "rhumb-bench"
            evaluate = f"evaluate --scene {scene} --seconds {seconds} --modes rhumb --no-limit --no-pin"
            call([bench, *evaluate.split(), "--out", out], cwd=out)
            replay = f"replay {out}/trace.mcap {options} --no-limit --no-trace"
            call([bench, *replay.split(), "--out", f"{out}/replay"], cwd=out)
            return json.loads(pathlib.Path(out, "replay/summary.json").read_text())

    def version(self):
        return call(["git", "-C", self.folder, "log", "-1", "--format=%h", "--abbrev=8"]).strip()


class Instruction(ctypes.Structure):
    """An instruction of a filter of system calls (seccomp)."""

    _fields_ = [("code", ctypes.c_ushort), ("jt", ctypes.c_ubyte), ("jf", ctypes.c_ubyte), ("k", ctypes.c_uint)]


class Program(ctypes.Structure):
    """Such a filter."""

    _fields_ = [("len", ctypes.c_ushort), ("filter", ctypes.POINTER(Instruction))]


def refuse_auxv():
    """Lets `prctl(PR_GET_AUXV)` fail: rustix finds the kernel's vDSO by it, which valgrind does not map."""
    calls = {"x86_64": 157, "aarch64": 167}
    load, equal, end = 0x20, 0x15, 0x06
    code = [
        (load, 0, 0, 0),
        (equal, 0, 3, calls[platform.machine()]),
        (load, 0, 0, 16),
        (equal, 0, 1, 0x41555856),
        (end, 0, 0, 0x00050000 | 22),
        (end, 0, 0, 0x7FFF0000),
    ]
    instructions = (Instruction * len(code))(*(Instruction(*one) for one in code))
    libc = ctypes.CDLL(None, use_errno=True)
    no_new_privileges, set_seccomp, by_filter = 38, 22, 2
    libc.prctl(no_new_privileges, 1, 0, 0, 0)
    libc.prctl(set_seccomp, by_filter, ctypes.byref(Program(len(code), instructions)), 0, 0)


def count(build, bench, name, function, since):
    """Instructions of `function` within a Criterion bench, since the last call of `since`."""
    with tempfile.TemporaryDirectory() as out:
        # Each pattern is for one purpose: two that begin alike would be one to callgrind.
        valgrind = ["valgrind", "--tool=callgrind", "--collect-atstart=no", f"--toggle-collect={function}"]
        valgrind += [f"--zero-before={since}", f"--callgrind-out-file={out}/counts"]
        environment = {**os.environ, "CRITERION_HOME": out}
        command = [*valgrind, build.bench(bench), "--bench", f"{name}$", "--profile-time", "5"]
        call(command, cwd=out, env=environment, preexec_fn=refuse_auxv)
        total = re.search(r"^(?:totals|summary): (\d+)", pathlib.Path(out, "counts").read_text(errors="replace"), re.M)
        if not total or total[1] == "0":
            raise Failed(f"callgrind met no {function} in {name} of {build.folder}")
        return int(total[1])


BODIES = 10_000
# Ticks that a run of publishing has, and reversals that the subscriber of the bench in mid-run decodes.
TICKS, REVERSALS = 60, 10_000
PUBLISH, DECODE, REFRESH = "*ObservedRun*publish*", "*DecodeLoad*decode*", "*RenderLoad*refresh*"
# The counts: words, unit, bench and its name, function, since which call, units of a call, the greatest ratio.
COUNTED = [
    (f"publishing {BODIES:,} balls {place}, {streams}", "a body and tick", "scene", f"publish/{scene}-{tiers}")
    + (PUBLISH, since, units, 0.45)
    for scene, place, since, units in [
        # A tick in which nothing must be said; the first ones have an update of each ball.
        ("flight", "in flight", "*stream*ObservationHistory*observe*", BODIES),
        ("burst", "in the burst", f"*setup{PUBLISH}", BODIES * TICKS),
    ]
    for tiers, streams in [("one-tier", "one stream"), ("four-tiers", "four tiers")]
] + [
    ("decoding what a body's reversal takes", "a reversal", "stream", "subscriber/mid-run")
    + (DECODE, f"*setup{DECODE}", REVERSALS, 0.55),
    (f"a view of {BODIES:,} moving bodies", "a body", "stream", "view/moving-bodies")
    + (REFRESH, f"*setup{REFRESH}", BODIES, 0.5),
]


def instructions(builds, _pairs):
    rows = []
    for what, unit, bench, name, function, since, units, greatest in COUNTED:
        old, new = (count(build, bench, name, function, since) / units for build in builds)
        row = {"what": what, "unit": f"instructions {unit}", "old": old, "new": new, "ratio": new / old}
        row |= {"aim": f"≤ {greatest} ×", "met": new <= greatest * old, "by": "instructions"}
        rows.append({**row, "command": f"cargo bench --bench {bench} -- {name}"})
    return {"rows": rows}


def again(run, attempts=3):
    """Calls `run` again where it fails: on a busy machine a connection may be too slow for a server."""
    for attempt in range(1, attempts + 1):
        try:
            return run()
        except Failed as cause:
            if attempt == attempts:
                raise
            print(f"again, as {cause}", file=sys.stderr)


def paired(builds, pairs, run, figures):
    """Calls `run` with both builds in turn; each figure's values by its name, per build."""
    values = [{name: [] for name in figures} for _ in builds]
    for pair in range(pairs):
        for place in [0, 1] if pair % 2 == 0 else [1, 0]:
            found = again(lambda: run(builds[place]))
            for name, figure in figures.items():
                values[place][name].append(figure(found))
    return values


def timed(row, values, name, pairs):
    old, new = (one[name] for one in values)
    ratios = sorted(after / before for before, after in zip(old, new))
    row |= {"old": statistics.median(old), "new": statistics.median(new), "ratio": statistics.median(ratios)}
    return {**row, "least": ratios[0], "most": ratios[-1], "by": f"{pairs} pairs, load {os.getloadavg()[2]:.0f}"}


def members(builds, pairs):
    arguments = "cost --bodies 100 --repeats 1 --members 32 --member-seconds 3"
    near = lambda costs: next(one for one in costs["members"] if one["round_trip_ms"] == 0)
    cost = lambda costs: near(costs)["server_loop_us"] + near(costs)["sockets_us"]
    floor = lambda costs: near(costs)["floor_us"]
    figures = {"cost": cost, "floor": floor, "of": lambda costs: cost(costs) / floor(costs)}
    values = paired(builds, pairs, lambda build: build.task(arguments, "cost.json"), figures)
    row = {"what": "a datagram to one of 32 subscribers", "unit": "us of processor", "command": arguments}
    row = timed({**row, "aim": "≤ 0.5 ×, ≤ 1.5 × floor"}, values, "cost", pairs)
    times = statistics.median(values[1]["of"])
    row["beside"] = f"floor {statistics.median(values[1]['floor']):.2f}, {times:.2f} ×"
    row["met"] = row["ratio"] <= 0.5 and times <= 1.5
    return {"rows": [row]}


def frames(builds, pairs):
    arguments = "load frames --bodies 10,500,1000 --ticks 200"
    def of(bodies, place, figure):
        def found(frames):
            scene = next(scene for scene in frames["scenes"] if scene["bodies"] == bodies)
            return next(one for one in scene["places"] if one["place"] == place)[figure]
        return found
    figures = {
        "processes": of(500, "unix socket", "longer_us"),
        "inside": of(1000, "in process", "of_integrated"),
        "fixed": of(10, "in process", "longer_us"),
    }
    values = paired(builds, pairs, lambda build: build.task(arguments, "frames.json"), figures)
    rows = []
    for name, what, unit, aim, greatest in [
        ("processes", "two processes: what a frame of 500 bodies takes longer than integrated", "us", "≤ 80 us", 80),
        ("inside", "in process: a frame of 1,000 bodies over an integrated one", "×", "≤ 1.03", 1.03),
        ("fixed", "in process: what a frame of 10 bodies takes longer", "us", "≤ 20 us", 20),
    ]:
        row = timed({"what": what, "unit": unit, "command": arguments, "aim": aim}, values, name, pairs)
        rows.append({**row, "met": row["new"] <= greatest})
    return {"rows": rows}


def filling(builds, pairs):
    """The old server is too slow for 80,000: a member that joins then gives up after 5 s."""
    kind = lambda name, figure: lambda filling: next(one for one in filling["scenes"] if one["kind"] == name)[figure]
    figures = {
        "fixed": kind("fixed boxes", "fill_s"),
        "awake": kind("boxes that fall", "fill_s"),
        "join": kind("fixed boxes", "join_s"),
        "joins": lambda filling: filling["joins_per_minute"],
        "beside": lambda filling: filling["beside"]["p99_us"] / filling["alone"]["p99_us"],
    }
    # Both servers have today's client.
    command = "load filling --filled {} --runs 1 --ticks 300 --join-seconds 5 --server "
    run = lambda build, bodies: builds[1].task(f"{command.format(bodies)}{build.release / 'rhumb-server'}", "filling.json")
    fewer = paired(builds, pairs, lambda build: run(build, 30_000), figures)
    many = [again(lambda: run(builds[1], 80_000)) for _ in range(pairs)]
    rows = []
    for name, what, unit, aim, met in [
        ("fixed", "loading {} fixed boxes by one client", "s", "≤ 3 s", lambda new: new <= 3),
        ("awake", "loading {} boxes that fall by one client", "s", "≤ 3 s", lambda new: new <= 3),
        ("join", "joining the scene of {} fixed boxes", "s", "≤ 0.5 s", lambda new: new <= 0.5),
        ("beside", "99th percentile of another scene's frame while {} are loaded, over alone", "×", "≤ 1.2", lambda new: new <= 1.2),
        ("joins", "joins of 2,000 bodies in a minute", "", "≥ 1,000", lambda new: new >= 1000),
    ]:
        row = {"what": what.format("30,000"), "unit": unit, "command": command.format(30_000) + "FILE"}
        row = timed(row, fewer, name, pairs)
        if name == "joins":
            rows.append({**row, "aim": aim, "met": met(row["new"])})
        else:
            rows.append(row)
            new = statistics.median(figures[name](one) for one in many)
            row = {"what": what.format("80,000"), "unit": unit, "new": new, "aim": aim, "met": met(new)}
            rows.append({**row, "by": f"{pairs} runs, load {os.getloadavg()[2]:.0f}", "command": command.format(80_000) + "FILE"})
    return {"rows": rows}


def recorded(build, file):
    """Records a session of 4,000 balls, as a member of the build's server receives it."""
    command = [build.release / "rhumb-server", "--open", "--listen", "127.0.0.1:0", "--log", "off"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            said = {}
            for line in server.stdout:
                name, _, value = line.strip().rpartition(" ")
                said[name] = value
                if {"listening on", "fingerprint"} <= said.keys():
                    break
            follow = [build.release / "rhumb-follow", "--server", said["listening on"], "--fingerprint", said["fingerprint"]]
            follow += ["--scene", "live", "--bodies", 4000, "--micrometres", 10_000, "--ticks", 150]
            call([*follow, "--out", os.devnull, "--record", file], input="\n")
        finally:
            server.kill()


def browser(builds, pairs):
    with tempfile.TemporaryDirectory() as folder:
        recording = pathlib.Path(folder, "recording.json")
        recorded(builds[1], recording)
        script = builds[1].folder / "bindings/web/test/measure.mjs"
        run = lambda build: json.loads(call(["node", script, build.folder / "bindings/web", recording, 3]))
        figures = {name: lambda found, name=name: found[name] for name in ["decode_ms", "view_ms"]}
        values = paired(builds, pairs, run, figures)
    command = "node bindings/web/test/measure.mjs bindings/web RECORDING"
    rows = []
    for name, what, greatest in [
        ("decode_ms", "browsers' client: decoding 150 ticks of 4,000 balls that burst", 0.55),
        ("view_ms", "browsers' client: a view of 4,000 balls", 0.5),
    ]:
        row = timed({"what": what, "unit": "ms", "command": command, "aim": f"≤ {greatest} ×"}, values, name, pairs)
        rows.append({**row, "met": row["ratio"] <= greatest})
    return {"rows": rows}


def page(builds, pairs):
    script = builds[1].folder / "viewer/test/measure.mjs"
    run = lambda build: call(["node", script, build.release / "rhumb-server", "undrawn", 10000])
    figures = {"p50": lambda text: float(re.search(r"JavaScript p50 ([0-9.]+) ms", text)[1])}
    values = paired(builds, pairs, run, figures)
    row = {"what": "the page with 10,000 balls: JavaScript of a frame, median", "unit": "ms", "aim": "≤ 0.5 ×"}
    row["command"] = "node viewer/test/measure.mjs SERVER undrawn 10000"
    row = timed(row, values, "p50", pairs)
    return {"rows": [{**row, "met": row["ratio"] <= 0.5}]}


REPLAY = "replay CUBES --tolerance 0.01 --no-limit --no-trace"
LOADS = [
    ("recorded cubes, 10 mm", REPLAY),
    ("recorded cubes, 10 mm, 6 ticks of lookahead", f"{REPLAY} --lookahead 6"),
    ("recorded cubes, 2 mm and 0.5°", "replay CUBES --tolerance 0.002 --turn 0.5 --no-limit --no-trace"),
    ("recorded cubes, 100 ms, 5 %", f"{REPLAY} --link rtt=100ms,loss=5%"),
    ("recorded cubes, 100 ms, 5 % in bursts of four", f"{REPLAY} --link rtt=100ms,loss=5%,burst=4"),
    ("recorded cubes, 300 ms, 5 %", f"{REPLAY} --link rtt=300ms,loss=5%"),
    ("pit of 500, lockstep", "evaluate --bodies 500 --seconds 30 --modes rhumb --no-limit --no-pin --no-trace"),
] + [
    (scene, f"evaluate --scene {scene} --seconds 20 --modes rhumb --no-limit --no-pin --no-trace")
    for scene in "asteroids asteroids-plain cubes dominoes free-fall ragdolls rain rest-10k stack tumbler zoo".split()
]
MOTIONS = ["asteroids", "asteroids-plain"]


def moved(run):
    """Share of moving body-ticks off, percent; `None` where no recording tells which bodies move."""
    moving = run.get("moving")
    return None if not moving else 100 * moving["over_tolerance_share"]


def compared(load, command, runs):
    """A row of bytes."""
    old, new = runs
    row = {"load": load, "old": old["payload_kbps_down"], "new": new["payload_kbps_down"]}
    row |= {"ratio": row["new"] / row["old"], "old_off": moved(old), "new_off": moved(new), "command": command}
    row |= {"same_truth": old["truth_hash"] == new["truth_hash"]}
    return row | {"faults": old["over_tolerance"]["by_cause"]["fault"] + new["over_tolerance"]["by_cause"]["fault"]}


def loads(builds, _pairs):
    rows = []
    for load, command in LOADS:
        runs = [build.task(command, "summary.json")["runs"][-1] for build in builds]
        rows.append(compared(load, command.replace("CUBES", CUBES.name), runs))
    options = "--publish-interval 2 --tolerance 0.01 --turn 0.1145916"
    for scene in MOTIONS:
        runs = [build.replay_of(scene, 120, options)["runs"][-1] for build in builds]
        command = f"evaluate --scene {scene} --seconds 120 --modes rhumb; replay trace.mcap {options}"
        rows.append(compared(f"{scene}, 10 mm and 2 mrad, 30 Hz", command, runs))
    return {"rows": list(aimed(rows)), "bytes": rows}


# Loads that have an aim: words, unit, load, its old and new figure, the greatest.
AIMED = [
    ("bursts of loss: moving body-ticks off", "%", LOADS[4][0], "old_off", "new_off", 2.0),
    ("recorded cubes within 10 mm, payload", "kbit/s", LOADS[0][0], "old", "new", 60.0),
    ("asteroids within 10 mm, 30 Hz, payload", "kbit/s", "asteroids, 10 mm and 2 mrad, 30 Hz", "old", "new", 9.6),
]


def aimed(loads):
    """Rows of the loads that have an aim."""
    for what, unit, name, before, after, greatest in AIMED:
        load = next(load for load in loads if load["load"] == name)
        old, new = load[before], load[after]
        row = {"what": what, "unit": unit, "old": old, "new": new, "ratio": new / old, "aim": f"≤ {greatest:g} {unit}"}
        yield {**row, "met": new <= greatest, "by": "one run", "command": load["command"]}


# The benches of stages; a pile takes minutes to come to rest.
STAGES = "^(codec|subscriber|view|join|add|publish/(asleep|flight|burst))"


def stages(builds, _pairs):
    """Criterion's means of the benches that both builds have."""
    means = []
    # Criterion itself has baselines named `new` and `base`.
    for build, name in zip(builds, ["before", "after"]):
        with tempfile.TemporaryDirectory() as out:
            environment = {**os.environ, "CRITERION_HOME": out}
            for bench in BENCHES:
                call([build.bench(bench), "--bench", STAGES, "--save-baseline", name], cwd=out, env=environment)
            found = {}
            for path in pathlib.Path(out).glob(f"**/{name}/estimates.json"):
                identity = "/".join(path.relative_to(out).parts[:-2])
                found[identity] = json.loads(path.read_text())["mean"]["point_estimate"]
            means.append(found)
    old, new = means
    names = [name for name in sorted(new) if name in old]
    return {"stages": [{"stage": name, "old_ns": old[name], "new_ns": new[name]} for name in names]}


PARTS = {
    "instructions": instructions,
    "members": members,
    "frames": frames,
    "filling": filling,
    "browser": browser,
    "page": page,
    "bytes": loads,
    "stages": stages,
}


def machine():
    text = pathlib.Path("/proc/cpuinfo").read_text() if sys.platform == "linux" else ""
    name = re.search(r"model name\s*: (.*)", text)
    return f"{name[1] if name else platform.machine()}, {os.cpu_count()} cores, {sys.platform}"


def measure(arguments):
    builds = [Build(arguments.old, True), Build(arguments.new, False)]
    kept = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    kept |= {"machine": machine(), "old": builds[0].version(), "new": builds[1].version()}
    for name in arguments.parts.split(","):
        if name not in PARTS:
            raise Failed(f"no part is named {name}: the parts are {', '.join(PARTS)}")
        print(f"{name} ...", file=sys.stderr)
        found = PARTS[name](builds, arguments.pairs)
        others = [row for row in kept.get("rows", []) if row["part"] != name]
        rows = others + [{"part": name, **row} for row in found.pop("rows", [])]
        kept |= {"rows": sorted(rows, key=lambda row: list(PARTS).index(row["part"])), **found}
        arguments.out.write_text(json.dumps(kept, indent=2, ensure_ascii=False) + "\n")
    print(f"written to {arguments.out}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    tasks = parser.add_subparsers(dest="task", required=True)
    building = tasks.add_parser("build", help="build the old commit and this checkout")
    measuring = tasks.add_parser("measure", help="measure both")
    for one in [building, measuring]:
        one.add_argument("old", type=pathlib.Path, help="folder of the old commit")
    measuring.add_argument("--new", type=pathlib.Path, default=ROOT, help="folder of the new one [default: this checkout]")
    measuring.add_argument("--parts", default=",".join(PARTS), help=f"of {', '.join(PARTS)} [default: all]")
    measuring.add_argument("--pairs", type=int, default=5, help="pairs of runs for times [default: 5]")
    measuring.add_argument("--out", type=pathlib.Path, default=OUT, help="the file of figures")
    arguments = parser.parse_args()
    try:
        if arguments.task == "build":
            build(arguments.old.resolve())
        else:
            arguments.old = arguments.old.resolve()
            measure(arguments)
    except (Failed, OSError, subprocess.CalledProcessError) as cause:
        print(f"error: {cause}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
