"""Prints the poses of a trace at some ticks, as the file's own schemas state them: the page's are compared with them.

    pip install mcap mcap-protobuf-support
    python3 viewer/test/poses.py trace.mcap LOAD/RUN TICK...

RUN names a run of the load, or is `truth`; without a LOAD it is one of the first load. The output is JSON: for each tick the bodies by their place, which is the
order in which they were placed, each with position and rotation. Bodies that come or leave right after a tick are left out.
"""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benches"))

from check_trace import Run, Truth, read  # noqa: E402


def poses(truth, run):
    """The bodies of this tick by place; those of the truth, or of a run's copy."""
    settled = [body for body in truth.pose if body not in truth.coming and body not in truth.leaving]
    places = {body: place for place, body in enumerate(truth.config)}
    shown = {body: truth.pose[body] if run is None else run.copy.get(body, truth.began[body]) for body in settled}
    return {places[body]: pose for body, pose in shown.items() if pose is not None}


def main(trace, load, name, ticks):
    records, topics = read(trace)
    states = next(topic for topic in topics if topic.endswith(f"/{load}/truth/state" if load else "/truth/state"))
    load = states.removesuffix("/truth/state")
    run = None
    if name != "truth":
        facts = next(record for key, record in records.items() if key.startswith(f"rhumb.run{load.replace('/', '.')}.") and record["name"] == name)
        run = Run(facts)
        run.stats = {stats.frame: stats for _, stats in topics[f"{load}/{name}/stats"]}
        run.seen = {poses.frame: poses for _, poses in topics[f"{load}/{name}/seen"]}
    truth, found = Truth(), {}
    for number, (_, message) in enumerate(topics[states]):
        if number == 0:
            # A recording of a server begins at any tick, with all bodies that are there.
            first = message.tick
        truth.step(message)
        if number == 0:
            truth.apply_changes()
        if run is not None:
            run.advance(truth, message.tick)
        if message.tick - first in ticks:
            found[message.tick - first] = poses(truth, run)
    print(json.dumps({"ticks": len(topics[states]), "bodies": len(truth.config), "poses": found}))


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    main(sys.argv[1], *sys.argv[2].rsplit("/", 1), {int(tick) for tick in sys.argv[3:]})
