"""Runs robots and scenes of public packages, and writes a table beside MuJoCo.

    python compare.py DATA PAGE [PART]      DATA: the folder of packages that `run` makes. PART: only paths that contain it.

Each file is run twice at once by two members of one scene, one within 50 mm and one within 1 mm, and by MuJoCo with the same
initial state, without actuation. A row has what differs. Each file is loaded in a process of its own, with a time limit. Rows are
kept in DATA/rows.jsonl, so that a run which was ended continues where it was.
"""

import collections
import hashlib
import json
import pathlib
import re
import subprocess
import sys

SECONDS = 10
LIMIT_S = 150
#: Folder of the packages, name, version, part of the paths that are left out (a thousand random meshes).
PACKAGES = (
    ("pybullet", "pybullet (pybullet_data)", "3.2.7", "random_urdfs"),
    ("example_robot_data", "example-robot-data", "6.0.0", None),
    ("dm_control", "dm-control", "1.0.50", None),
    ("gymnasium_robotics", "gymnasium-robotics", "1.4.2", None),
)


def files(data):
    """Package, version and path of each file that is a whole URDF or MJCF."""
    for folder, package, version, without in PACKAGES:
        for path in sorted((data / folder).rglob("*")):
            if path.suffix not in (".urdf", ".xml") or (without and without in str(path)):
                continue
            head = path.read_text(errors="replace")[:20000]
            # A <mujocoinclude> is a part that others include.
            if re.search(r"<robot\b|<mujoco\b", head):
                yield package, version, path


def kinds_of(notes):
    """The kinds of notes about parts left out or changed: the words before a name."""
    kinds = collections.Counter()
    for note in notes:
        text = note.split(": ", 1)[1] if ": " in note else note
        words = text.split(" (")[0].split(":")[0]
        for effect in ("left out", "changed", "approximated"):
            if effect in words:
                subject = words.split(effect)[0].strip()
                kinds[subject.split('"')[0].strip().split(" of ")[0] + (" " + subject.split('"')[-1].strip() if '"' in subject else "")] += 1
    return [kind.strip() for kind, _ in kinds.most_common()]


def run_ours(path, base):
    """Bodies by name: centres of mass at half a second, one and ten, and the greatest error of the coarser copy, metres."""
    import numpy as np
    import rhumb

    server = rhumb.LocalServer()

    def make(**options):
        return server.connect(timeout=60).join("file", tolerance=0.001, **options)

    fine, loaded = rhumb.load(str(path), make, coordinates="z-up", base=base)
    coarse = server.connect(timeout=60).join("file", coordinates="z-up", tolerance=0.05)
    rate = fine_rate(path)
    names = {body: name for name, body in loaded.bodies.items()}
    seen, worst, fastest = {}, 0.0, 0.0
    for tick in range(1, SECONDS * rate + 1):
        fine.advance()
        while coarse.advance() < tick:
            pass
        if len(fine):
            order = np.argsort(fine.bodies), np.argsort(coarse.bodies)
            if len(order[0]) == len(order[1]):
                apart = fine.positions[order[0]] - coarse.positions[order[1]]
                worst = max(worst, float(np.linalg.norm(apart, axis=1).max()))
        if tick in (rate // 2, rate, SECONDS * rate):
            at = {names[int(body)]: place for place, body in enumerate(fine.bodies)}
            seen[tick / rate] = {name: [float(x) for x in fine.positions[place]] for name, place in at.items()}
        if len(fine):
            fastest = max(fastest, float(np.linalg.norm(fine.linear_velocities, axis=1).max()))
    return {
        "bodies": len(loaded.bodies),
        "joints": len(loaded.joints),
        "notes": loaded.left_out,
        "seen": list(seen.values()),
        "copy": worst,
        "fastest": fastest,
    }


def fine_rate(path):
    import rhumb

    return rhumb._native.file_settings(str(path))[1] or 60


def run_mujoco(path, urdf):
    """Centres of mass of bodies with those that are welded to them, at the same moments; None: MuJoCo does not load it."""
    import mujoco
    import numpy as np

    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError):
        return None
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
    if urdf:
        # There is nothing but one robot, whose parts touch each other in MuJoCo alone.
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    groups = collections.defaultdict(list)
    for body in range(1, model.nbody):
        if model.body_weldid[body] != 0:
            groups[int(model.body_weldid[body])].append(body)
    seen = []
    for moment in (0.5, 1.0, float(SECONDS)):
        while data.time < moment - model.opt.timestep / 2:
            mujoco.mj_step(model, data)
        centres = {}
        for first, members in groups.items():
            masses = model.body_mass[members]
            if masses.sum() > 0:
                centres[model.body(first).name] = (masses @ data.xipos[members] / masses.sum()).tolist()
        seen.append(centres if np.isfinite(data.qpos).all() else None)
    return seen


def one(path):
    """One file, in this process."""
    urdf = "<robot" in path.read_text(errors="replace")[:20000]
    # MuJoCo welds the root of a URDF to the world.
    ours = run_ours(path, "fixed" if urdf else "file")
    ours["mujoco"] = run_mujoco(path, urdf)
    return ours


def greatest_distance(one, other):
    import numpy as np

    common = one.keys() & other.keys()
    return max((float(np.linalg.norm(np.subtract(one[name], other[name]))) for name in common), default=None), len(common)


def row(package, version, path, data):
    """The row of a file, whether it was loaded, and whether it is within 10 mm of MuJoCo early and late, if both ran it."""
    place = "/".join(path.relative_to(data).parts[-3:])
    command = [sys.executable, __file__, "--one", str(path)]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S)
    except subprocess.TimeoutExpired:
        return f"| {place} | {package} {version} | | | longer than {LIMIT_S} s | | | | |", False, None
    if ended.returncode != 0:
        lines = ended.stderr.strip().splitlines()
        why = (lines[-1] if lines else "no word").replace(str(path.parent) + "/", "").replace(str(data), "").replace("|", "\\|")
        why = why.split("InvalidError: ")[-1][:160]
        return f"| {place} | {package} {version} | | | not loaded: {why} | | | | |", False, None
    found = json.loads(ended.stdout.splitlines()[-1])
    distances = ["", ""]
    near = None
    if found["mujoco"] is not None:
        distances = []
        for ours, theirs in zip(found["seen"], found["mujoco"]):
            distance, common = (None, 0) if theirs is None else greatest_distance(ours, theirs)
            distances.append(distance)
        both = [distances[0], distances[2]]
        near = None if None in both else [distance <= 0.01 for distance in both]
        distances = ["" if distance is None else f"{distance * 1e3:.3g}" for distance in both]
    kinds = kinds_of(found["notes"])
    left = f"{len(found['notes'])}: {', '.join(kinds[:4])}" if found["notes"] else "nothing"
    return (
        f"| {place} | {package} {version} | {found['bodies']} | {found['joints']} | {left} "
        f"| {distances[0]} | {distances[1]} | {found['fastest']:.3g} | {found['copy'] * 1e3:.1f} |"
    ), True, near


class Known:
    """Rows of an earlier run of the same library, which was ended: a whole run takes some hours."""

    def __init__(self, path):
        import rhumb

        with open(rhumb._native.__file__, "rb") as library:
            self.library = hashlib.file_digest(library, "sha256").hexdigest()[:16]
        self.path = path
        lines = path.read_text().splitlines() if path.exists() else []
        of_all = [json.loads(line) for line in lines]
        self.rows = {name: row for library, name, row in of_all if library == self.library}

    def add(self, name, row):
        with open(self.path, "a") as rows:
            rows.write(json.dumps([self.library, name, row]) + "\n")


PAGE = """# Files that were loaded

Every URDF and MJCF file of four public packages, but for parts that others include, loaded and run for ten seconds by
`sims/files/compare/run WHEEL`, which fetches the packages and writes this page. {loaded} of {all} were loaded.{ended}

- *Left out* counts the notes of the loader, and names the most frequent kinds. Drawing and actuation are among them.
- *From MuJoCo* is the greatest distance, in millimetres, between the centres of mass of a body here and in MuJoCo 4.0.0, after half a second
  and after ten: both begin in the pose of the file, without actuation. The root of a URDF is fixed, as in MuJoCo, and its parts do not
  touch each other, as in most programs that read such files: MuJoCo would let them. It is empty where MuJoCo does not load the file or
  has no moving body of the same name.
- *Fastest* is the greatest speed of a centre of mass in the ten seconds here, m/s.
- *Copy* is the greatest distance, in millimetres, between the copies of two members at any tick, one within 50 mm and one within 1 mm.

What makes a row large:

- Engines part once bodies touch, or as joints swing. Of {compared} files that both ran, {near} are within 10 mm after half a second and
  {late} after ten: the others drift apart with time.
- A file that starts a joint outside its limits (`joint limits` in *left out*: a1, aliengo, laikago, panda) is pulled into them, by each
  engine at its own pace.
- An armature is part of a body's moments here, as far as the body that holds it carries it, and resists the joint alone there; that of
  a slide, tendons and couplings of joints act there alone.
- Damping and stiffness are converted with the mass that they move in the pose of the start.

| file | package | bodies | joints | left out | from MuJoCo, 0.5 s | 10 s | fastest | copy |
|---|---|---:|---:|---|---:|---:|---:|---:|
"""


def main():
    if sys.argv[1] == "--one":
        print(json.dumps(one(pathlib.Path(sys.argv[2]))))
        return
    data, page = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2])
    part = sys.argv[3] if len(sys.argv) > 3 else ""
    rows, left = [], 0
    known = Known(data / "rows.jsonl")
    for package, version, path in files(data):
        if part not in str(path):
            continue
        name = str(path.relative_to(data))
        found = known.rows.get(name)
        if found is None and not left:
            try:
                found = row(package, version, path, data)
                known.add(name, found)
                print(found[0], flush=True)
            except KeyboardInterrupt:
                print("ended: the page has what is known", file=sys.stderr)
        if found is None:
            left += 1
        else:
            rows.append(found)
    near = [near for _, _, near in rows if near is not None]
    head = PAGE.format(
        loaded=sum(was for _, was, _ in rows),
        ended=f" This run was ended before {left} further files." if left else "",
        all=len(rows),
        compared=len(near),
        near=sum(early for early, _ in near),
        late=sum(early and late for early, late in near),
    )
    page.write_text(head + "\n".join(text for text, _, _ in rows) + "\n")


if __name__ == "__main__":
    main()
