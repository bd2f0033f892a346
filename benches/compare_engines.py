#!/usr/bin/env python3
"""Measures other engines, in process and remote, on one of our scenes: frame times and bytes on the wire.

    rhumb-bench dev scene ball-pit --bodies 500 --out results/scene.json
    pip install pybullet sapien
    python3 benches/compare_engines.py results/scene.json --physx --bullet direct --bullet tcp:localhost:6667 \
        --rhumb target/release/rhumb-bench

A frame is one step of the scene's length and a read of every moving body's pose through the engine's own interface. Bullet
comes from the `pybullet` package, PhysX 5 from the `sapien` package; install them before use. Start a remote Bullet server
separately and name it here: `shared-memory`, `tcp:HOST:PORT` or `udp:HOST:PORT`. Its bytes are the counters of the network
interface, headers included, in both directions; the machine must be otherwise idle. Piles differ between engines, so times
measure similar work, not the same work.

Standard output has a table; `--out` writes the figures as JSON. On failure the exit code is 1, with a sentence on standard
error.
"""

import argparse
import json
import math
import os
import pathlib
import platform
import shlex
import statistics
import subprocess
import sys
import tempfile
import time


class Impossible(Exception):
    """A request that the comparison cannot fulfil, with a sentence for the user."""


def read(path):
    """A scene as `rhumb-bench dev scene` writes it."""
    try:
        scene = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as cause:
        raise Impossible(f"{path} is not a scene: {cause}") from None
    bodies = scene.get("bodies") if isinstance(scene, dict) else None
    if not isinstance(bodies, list) or not all(isinstance(body, dict) for body in bodies):
        raise Impossible(f"{path} is not a scene: it has no bodies")
    return scene


def volume(shape):
    """Volume of a ball or a cuboid, m³."""
    if "ball" in shape:
        return 4 / 3 * math.pi * shape["ball"]["radius"] ** 3
    if "cuboid" in shape:
        x, y, z = shape["cuboid"]["half_extents"]
        return 8 * x * y * z
    raise Impossible(f"only scenes of balls and cuboids can be compared; this one has a {next(iter(shape))}")


class Bullet:
    """Bullet by `pybullet`, in this process or at a server."""

    def __init__(self, scene, where):
        try:
            import pybullet
        except ImportError as cause:
            raise Impossible(f"pybullet is not installed ({cause}): pip install pybullet") from cause
        self.bullet = pybullet
        self.name = f"bullet, {where}"
        self.client = self.connect(where)
        options = {"physicsClientId": self.client}
        pybullet.resetSimulation(**options)
        pybullet.setGravity(*scene["gravity"], **options)
        pybullet.setPhysicsEngineParameter(fixedTimeStep=scene["step_s"], numSubSteps=1, **options)
        numbers = [self.add(scene, body) for body in scene["bodies"]]
        self.bodies = [number for number in numbers if number is not None]

    def connect(self, where):
        kind, _, place = where.partition(":")
        bullet = self.bullet
        if kind == "direct":
            return bullet.connect(bullet.DIRECT)
        if kind == "shared-memory":
            client = bullet.connect(bullet.SHARED_MEMORY)
        elif kind in ("tcp", "udp"):
            host, _, port = place.rpartition(":")
            if not host or not port.isdigit():
                raise Impossible(f"{where} lacks a host and port, such as {kind}:localhost:6667")
            client = bullet.connect(bullet.TCP if kind == "tcp" else bullet.UDP, hostName=host, port=int(port))
        else:
            raise Impossible(f"{where} is not one of direct, shared-memory, tcp:HOST:PORT, udp:HOST:PORT")
        if client < 0:
            raise Impossible(f"no Bullet server answers at {where}: start one first")
        return client

    def add(self, scene, body):
        bullet, options = self.bullet, {"physicsClientId": self.client}
        shape = body["shape"]
        mass = scene["density"] * volume(shape) if body["dynamic"] else 0
        if "ball" in shape:
            form = bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=shape["ball"]["radius"], **options)
        else:
            form = bullet.createCollisionShape(
                bullet.GEOM_BOX, halfExtents=shape["cuboid"]["half_extents"], **options
            )
        number = bullet.createMultiBody(
            baseMass=mass,
            baseCollisionShapeIndex=form,
            basePosition=body["position"],
            baseOrientation=body["rotation"],
            useMaximalCoordinates=1,
            **options,
        )
        if number < 0:
            raise Impossible(f"{self.name} accepts only {bullet.getNumBodies(**options)} bodies")
        bullet.changeDynamics(
            number,
            -1,
            lateralFriction=scene["friction"],
            restitution=scene["restitution"],
            linearDamping=scene["linear_damping"],
            angularDamping=scene["angular_damping"],
            activationState=bullet.ACTIVATION_STATE_ENABLE_SLEEPING,
            **options,
        )
        if not body["dynamic"]:
            return None
        bullet.resetBaseVelocity(number, body["linear"], body["angular"], **options)
        return number

    def frame(self):
        self.bullet.stepSimulation(physicsClientId=self.client)
        pose = self.bullet.getBasePositionAndOrientation
        return [pose(body, physicsClientId=self.client) for body in self.bodies]

    def end(self):
        self.bullet.disconnect(physicsClientId=self.client)


class PhysX:
    """PhysX 5 by `sapien`, in this process."""

    def __init__(self, scene):
        try:
            import sapien
            from sapien import physx
        except ImportError as cause:
            raise Impossible(f"sapien is not installed ({cause}): pip install sapien") from cause
        self.name = f"physx {physx.version()}, direct"
        physx.set_scene_config(gravity=scene["gravity"])
        self.system = physx.PhysxCpuSystem()
        self.system.timestep = scene["step_s"]
        self.world = sapien.Scene([self.system])
        surface = physx.PhysxMaterial(scene["friction"], scene["friction"], scene["restitution"])
        self.bodies = []
        for body in scene["bodies"]:
            shape = body["shape"]
            volume(shape)
            if "ball" in shape:
                form = physx.PhysxCollisionShapeSphere(shape["ball"]["radius"], surface)
            else:
                form = physx.PhysxCollisionShapeBox(shape["cuboid"]["half_extents"], surface)
            form.density = scene["density"]
            part = physx.PhysxRigidDynamicComponent() if body["dynamic"] else physx.PhysxRigidStaticComponent()
            part.attach(form)
            entity = sapien.Entity()
            entity.add_component(part)
            x, y, z, w = body["rotation"]
            entity.set_pose(sapien.Pose(body["position"], [w, x, y, z]))
            self.world.add_entity(entity)
            if body["dynamic"]:
                part.linear_damping = scene["linear_damping"]
                part.angular_damping = scene["angular_damping"]
                part.linear_velocity = body["linear"]
                part.angular_velocity = body["angular"]
                self.bodies.append(part)

    def frame(self):
        self.system.step()
        return [(part.entity_pose.p, part.entity_pose.q) for part in self.bodies]

    def end(self):
        self.world = None


def interface_bytes(interface):
    """Bytes that a network interface has received and sent."""
    folder = pathlib.Path("/sys/class/net") / interface / "statistics"
    try:
        return tuple(int((folder / f"{way}_bytes").read_text()) for way in ("rx", "tx"))
    except OSError:
        return None


def measure(engine, frames, interface):
    """Steps an engine and returns its frame times."""
    engine.frame()
    before = interface_bytes(interface)
    took = []
    poses = []
    for _ in range(frames):
        begun = time.perf_counter()
        poses = engine.frame()
        took.append((time.perf_counter() - begun) * 1e3)
    after = interface_bytes(interface)
    lowest = min((float(position[1]) for position, _ in poses), default=0.0)
    if not math.isfinite(lowest):
        raise Impossible(f"{engine.name} lost a body")
    took.sort()
    remote = "direct" not in engine.name and "shared" not in engine.name
    count = before is not None and after is not None and remote
    return {
        "engine": engine.name,
        "frames": frames,
        "frame_ms_mean": statistics.fmean(took),
        "frame_ms_p50": statistics.median(took),
        "frame_ms_p99": took[math.ceil(0.99 * len(took)) - 1],
        # Loopback counts each packet as sent and as received, so either counter covers both directions.
        "bytes_per_frame": (after[0] - before[0]) / frames if count else None,
        "lowest_body_m": lowest,
    }


def of_engine(start, frames, interface):
    """Measures one engine; returns its row."""
    try:
        engine = start()
        row = measure(engine, frames, interface)
        engine.end()
    except Exception as cause:
        # The package's own error derives directly from Exception.
        if type(cause).__module__ == "pybullet":
            raise Impossible(f"Bullet: {cause}") from cause
        raise
    return row


def rhumb_rows(bench, scene, frames):
    """Rows of the same scene with Rhumb: integrated, naive, lockstep."""
    balls = sum(body["dynamic"] for body in scene["bodies"])
    with tempfile.TemporaryDirectory() as folder:
        command = [bench, "evaluate", "--scene", scene["scene"], "--bodies", str(balls), "--seed", str(scene["seed"])]
        command += ["--seconds", str(frames * scene["step_s"]), "--modes", "integrated,naive,rhumb"]
        command += ["--no-trace", "--no-limit", "--out", folder]
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        if ended.returncode != 0:
            raise Impossible(f"{bench} failed: {ended.stderr.strip()}")
        summary = json.loads((pathlib.Path(folder) / "summary.json").read_text())
    rows = []
    for run in summary["runs"]:
        wire = run["bytes_down"]
        rows.append(
            {
                "engine": f"rhumb-bench, {run['mode']}",
                "frames": run["ticks"],
                "frame_ms_mean": run["frame_ms"]["mean"],
                "frame_ms_p50": run["frame_ms"]["p50"],
                "frame_ms_p99": run["frame_ms"]["p99"],
                "bytes_per_frame": (wire + run["bytes_up"]) / run["ticks"] if wire is not None else None,
                "lowest_body_m": None,
            }
        )
    return rows


def machine():
    """Processor, cores, operating system."""
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    name = named[0] if named else platform.processor() or "unknown"
    return f"{name}, {os.cpu_count()} cores, {platform.system().lower()}"


def table(rows):
    """Prints aligned rows, each relative to the same engine in process."""
    base = {}
    for row in rows:
        family = row["engine"].split(",")[0]
        base.setdefault(family, row["frame_ms_p50"])
    lines = [["engine", "frame p50, ms", "p99, ms", "relative to first row", "bytes per frame"]]
    for row in rows:
        family = row["engine"].split(",")[0]
        wire = row["bytes_per_frame"]
        lines.append(
            [
                row["engine"],
                f"{row['frame_ms_p50']:.3f}",
                f"{row['frame_ms_p99']:.3f}",
                f"{row['frame_ms_p50'] / base[family]:.2f}",
                "" if wire is None else f"{wire:,.0f}",
            ]
        )
    widths = [max(len(line[column]) for line in lines) for column in range(len(lines[0]))]
    for line in lines:
        print("  ".join(cell.ljust(width) for cell, width in zip(line, widths)).rstrip())


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("scene", type=pathlib.Path, help="output of `rhumb-bench dev scene`")
    parser.add_argument("--frames", type=int, default=120, help="number of timed steps (120)")
    parser.add_argument("--physx", action="store_true", help="PhysX 5 in process")
    parser.add_argument(
        "--bullet",
        action="append",
        default=[],
        metavar="WHERE",
        help="direct, shared-memory, tcp:HOST:PORT or udp:HOST:PORT; may be repeated",
    )
    parser.add_argument("--rhumb", metavar="BENCH", help="the rhumb-bench binary, for Rhumb's rows")
    parser.add_argument("--interface", default="lo", help="network interface whose bytes are counted for a remote server (lo)")
    parser.add_argument("--out", type=pathlib.Path, help="output file of the figures as JSON")
    arguments = parser.parse_args()
    if arguments.frames < 1:
        parser.error("--frames must be at least 1")
    try:
        scene = read(arguments.scene)
        if any(body["tick"] > 0 for body in scene["bodies"]):
            raise Impossible("only scenes with all bodies at the first tick can be compared: write fewer ticks")
        rows = []
        engines = [lambda where=where: Bullet(scene, where) for where in arguments.bullet]
        engines += [lambda: PhysX(scene)] * arguments.physx
        for start in engines:
            rows.append(of_engine(start, arguments.frames, arguments.interface))
        if arguments.rhumb:
            rows += rhumb_rows(arguments.rhumb, scene, arguments.frames)
        if not rows:
            raise Impossible("no engine was selected: see --help")
        table(rows)
        if arguments.out:
            output = {
                "command": shlex.join(["python3", *sys.argv]),
                "machine": machine(),
                "scene": scene["scene"],
                "bodies": sum(body["dynamic"] for body in scene["bodies"]),
                "rows": rows,
            }
            arguments.out.write_text(json.dumps(output, indent=2) + "\n")
    except (Impossible, OSError, KeyError) as cause:
        message = f"{arguments.scene} has no {cause}" if isinstance(cause, KeyError) else cause
        print(f"error: {message}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
