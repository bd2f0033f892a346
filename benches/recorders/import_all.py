"""Makes and imports recordings, and writes a table of them: import_all.py BENCH WORK PAGE. `import_all` fetches what it needs."""

import pathlib
import re
import subprocess
import sys

BENCH, WORK, PAGE = sys.argv[1], pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[3])
HERE = pathlib.Path(__file__).parent
MADE = WORK / "made"
EVO = "fetched/evo/test/data/"

PAGE_HEAD = """# Recordings that were imported

`benches/recorders/import_all BENCH` records with each recorder of [`benches/recorders`](../../../benches/recorders), fetches recordings of
pinned public packages, imports all of them, and writes this page. It is no part of CI.

- *Check* is what [`check`](own-recording.md#check) finds: gravity, substeps, damping (exponential, linear and angular), bodies whose spin
  wanders, that keep it and that are driven, and its warnings.
- *Bytes* are those of the file, and of the `.rhtrace.zst` that `import` makes of it: every number of the states, packed.
- *Updates* are those of a second in `replay` within 10 mm, with `--fit` for recordings of engines, and where gravity was found.

"""

#: Name, package and version, path below WORK, options.
FOUND = (
    ("skeleton, 15 s", "crate bvh_anim 0.4.0", "crates/vendor/bvh_anim/data/test_mocapbank.bvh", ["--unit", "cm"]),
    ("robot, odometry", "PyPI evo 1.38.1", EVO + "nav2_turtlebot.mcap", ["--load", "odometry", "--resample", "25"]),
    ("robot, transforms", "PyPI evo 1.38.1", EVO + "nav2_turtlebot.mcap", ["--load", "tf", "--resample", "25"]),
    ("drone, EuRoC V1_02", "PyPI evo 1.38.1", EVO + "V102_groundtruth.csv", ["--gravity", "0,0,-9.81"]),
    ("camera, TUM fr1/xyz", "PyPI evo 1.38.1", EVO + "freiburg1_xyz-groundtruth.txt", ["--resample", "100"]),
    ("camera, TUM fr2/desk", "PyPI evo 1.38.1", EVO + "fr2_desk_groundtruth.txt", ["--resample", "100"]),
    ("camera, KITTI 00", "PyPI evo 1.38.1", EVO + "KITTI_00_gt.txt", []),
    ("transforms of ROS 1", "crate mcap 0.26.0", "crates/vendor/mcap/tests/data/compressed.mcap", []),
    ("bag of ROS 1", "PyPI evo 1.38.1", EVO + "tf_example.bag", []),
)


def run(*command, env=None):
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, timeout=900, env=env, cwd=MADE)


def recorded():
    """Name, package, path, options of what the recorders write."""
    python = sys.executable
    for name, package, command, path in (
        ("60 boxes, MuJoCo", "PyPI mujoco 4.0.0", [python, HERE / "mujoco_boxes.py"], MADE / "mujoco.npz"),
        ("60 boxes, PyBullet", "PyPI pybullet 3.2.7", [python, HERE / "pybullet_boxes.py"], MADE / "pybullet.npz"),
        ("60 boxes, Newton", "PyPI newton 1.8.0", [python, HERE / "newton_boxes.py"], MADE / "newton.npz"),
        ("60 boxes, Rapier", "npm @dimforge/rapier3d-compat 0.21.0", ["node", MADE / "rapier_boxes.mjs"], MADE / "rapier.rhtrace"),
        ("60 boxes, Jolt", "npm jolt-physics 1.1.0", ["node", MADE / "jolt_boxes.mjs"], MADE / "jolt.rhtrace"),
    ):
        done = run(*command, path)
        if done.returncode != 0:
            sys.exit(f"{command}: {done.stderr}")
        yield name, package, path, []


def place(frame, marker):
    """Position of a marker, millimetres."""
    return [10.0 * frame, 100.0 * marker, 900.0 + 50.0 * ((frame // 10) % 2)]


def markers():
    """Walks of four markers as two libraries write them; one marker is hidden for three frames."""
    import c3d
    import ezc3d
    import numpy as np

    frames = 240
    points = np.array([[place(f, m) + [0.0] for m in range(4)] for f in range(frames)])
    labels = ["LASI", "RASI", "LKNE", "RKNE"]
    one = ezc3d.c3d()
    one["parameters"]["POINT"]["RATE"]["value"] = [119.88]
    one["parameters"]["POINT"]["LABELS"]["value"] = labels
    one["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    data = points.transpose(2, 1, 0).copy()
    data[:3, 2, 50:53] = np.nan
    data[3] = 1
    one["data"]["points"] = data
    one.write(str(MADE / "ezc3d.c3d"))
    yield "4 markers", "written by PyPI ezc3d 1.7.2", MADE / "ezc3d.c3d", []
    # A scale below zero: numbers with a point, in the file's own unit.
    two = c3d.Writer(point_rate=100.0, point_scale=-1.0)
    two.set_point_labels(labels)
    for frame in range(frames):
        rows = np.zeros((4, 5), np.float32)
        rows[:, :3] = points[frame, :, :3]
        if 50 <= frame < 53:
            rows[2, 3] = -1
        two.add_frames([(rows, np.empty((0, 0)))])
    with open(MADE / "c3d.c3d", "wb") as file:
        two.write(file)
    yield "4 markers", "written by PyPI c3d 0.6.0", MADE / "c3d.c3d", []


def checked(text):
    """Findings in a few words, and warnings."""
    words = []
    if found := re.search(r"gravity (\S+) m/s", text):
        words.append("gravity " + ", ".join(f"{float(n):.2f}" for n in found[1].split(",")).replace("-0.00", "0.00"))
    if found := re.search(r"(\d+) substeps", text):
        words.append(f"{found[1]} substeps")
    if found := re.search(r"exponential (\S+) and (\S+) 1/s", text):
        words.append("damping " + " and ".join(f"{float(n):.3f}".replace("-0.000", "0.000") for n in found.groups()))
    if found := re.search(r"spin: (\d+) bodies wander .*, (\d+) keep", text):
        words.append(f"{found[1]} wander, {found[2]} keep their spin")
    if found := re.search(r"(\d+) bodies turn or accelerate as no free body", text):
        words.append(f"{found[1]} driven")
    warnings = re.findall(r"^warning: (.*)$", text, re.MULTILINE)
    return "; ".join(words) or "nothing", "; ".join(warning.split(":")[0] for warning in warnings)


def row(name, package, path, options):
    packed = MADE / "packed.rhtrace.zst"
    done = run(BENCH, "import", path, *options, "--out", packed)
    if done.returncode != 0:
        said = done.stderr.strip().replace(str(path), path.name).splitlines()[-1].removeprefix("error: ")
        return f"| {name} | {package} | | | refused: {said.split('; read are')[0]} | | |"
    check = run(BENCH, "check", path, *options).stdout
    bodies = re.search(r"(\d+) bodies", done.stdout)[1]
    rate = float(re.search(r"at ([\d.]+) Hz", check)[1])
    fit = ["--fit"] if "--gravity" in check or path.suffix in (".npz", ".rhtrace") else []
    replayed = run(BENCH, "replay", path, *options, *fit, "--tolerance", "0.01", "--no-limit", "--no-trace", "--out", MADE / "replay")
    cells = re.findall(r"^10 mm  .*$", replayed.stdout, re.MULTILINE)
    updates = re.split(r"\s{2,}", cells[0])[3] if cells else replayed.stderr.strip().splitlines()[-1].removeprefix("error: ")
    found, warnings = checked(check)
    sizes = f"{path.stat().st_size:,} → {packed.stat().st_size:,}"
    text = found + (f"; **warns**: {warnings}" if warnings else "")
    return f"| {name} | {package} | {bodies} | {rate:g} | {text} | {sizes} | {updates} |"


def bag():
    """Writes a bag of ROS 2, and compares it with its recording by two readers of others."""
    import numpy as np
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory
    from rosbags.typesys import Stores, get_typestore

    done = run(BENCH, "import", MADE / "mujoco.npz", "--out", MADE / "bag.mcap")
    if done.returncode != 0:
        sys.exit(done.stderr)
    store = get_typestore(Stores.ROS2_JAZZY)
    qpos = np.load(MADE / "mujoco.npz")["qpos"].reshape(-1, 60, 7)
    worst, clocks, transforms = 0.0, [], 0
    with open(MADE / "bag.mcap", "rb") as file:
        for schema, channel, message, decoded in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            again = store.deserialize_cdr(message.data, schema.name)
            if bytes(store.serialize_cdr(again, schema.name)) != bytes(message.data):
                sys.exit(f"{channel.topic}: rosbags writes other bytes")
            if channel.topic == "/clock":
                clocks.append(decoded.clock.sec * 10**9 + decoded.clock.nanosec)
                continue
            for one, other in zip(decoded.transforms, again.transforms, strict=True):
                transforms += 1
                frame = round((one.header.stamp.sec - 1 + one.header.stamp.nanosec * 1e-9) * 60)
                t, r = one.transform.translation, one.transform.rotation
                true = qpos[frame, int(one.child_frame_id.removeprefix("body_"))]
                mine = np.array([t.x, t.y, t.z, r.w, r.x, r.y, r.z])
                turned = mine.copy()
                turned[3:] *= -1
                worst = max(worst, min(np.abs(mine - true).max(), np.abs(turned - true).max()))
                if (other.transform.translation.x, other.child_frame_id, other.header.frame_id) != (t.x, one.child_frame_id, "world"):
                    sys.exit("the readers differ")
    steps = np.diff(clocks)
    return (
        f"The MuJoCo recording as a bag (`import --out bag.mcap`): {len(clocks)} clocks {steps.min() / 1e6:.3f} to {steps.max() / 1e6:.3f} ms "
        f"apart and {transforms:,} transforms. PyPI mcap-ros2-support 0.6.0 and rosbags 0.11.9 read all of them alike, rosbags writes every "
        f"message back to the same bytes, and no number is further than {worst:.1e} from the recording. ROS 2 itself was not run.\n"
    )


def main():
    rows = [row(*one) for one in (*recorded(), *markers())]
    rows += [row(name, package, WORK / path, options) for name, package, path, options in FOUND]
    head = "| recording | package | bodies | Hz | check | bytes | updates/s |\n|---|---|---:|---:|---|---:|---:|\n"
    PAGE.write_text(PAGE_HEAD + head + "\n".join(rows) + "\n\n## A bag of ROS 2\n\n" + bag())


main()
