#!/usr/bin/env python3
"""Recomputes the figures of summary.json from trace.mcap and reports the differences.

Uses the file format, the embedded schemas and the definitions of the figures, but no code of the program that wrote the
files. Errors are recomputed from the engine's states and the poses of the client's copy.

    pip install mcap mcap-protobuf-support
    python3 benches/check_trace.py results/trace.mcap results/summary.json
"""

import json
import math
import os
import sys
from array import array
from collections import Counter, defaultdict

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

STATIC = 1
CAUSES = {1: "loss", 2: "late", 3: "fault", 4: "budget"}
STATE_DOWN, CONTROL_DOWN = 1, 3
SIM_FPS_MAX = 11.33
FIRST_S = 5.0
# Rounding of the copy: f32, with the rotation normalised before and after rounding. At 128 m this is up to 16 um.
EXACT_M = 2e-5
# Rounding of two poses to the grid: of positions, and of rotations for each metre of a body's radius.
GRID_M, GRID_M_PER_RADIUS = 3e-6, 4e-6
# Greatest size of a trace: schemas and indices, and each body at each tick of a run, of which a whole state has 56 bytes.
OVERHEAD_BYTES, MOMENT_BYTES = 200_000, 16
# Steps of the grid in a metre, and in a unit of a quaternion's components.
STEPS = 2.0**20
MASK = (1 << 64) - 1


class Report:
    """Counts passed and failed checks, and prints the failed ones."""

    def __init__(self):
        self.passed = 0
        self.failed = 0
        self.where = ""

    def check(self, holds, what):
        if holds:
            self.passed += 1
        else:
            self.failed += 1
            print(f"FAILED {self.where}: {what}")

    def same(self, name, ours, theirs, relative=1e-9, absolute=0.0):
        if ours is None or theirs is None or isinstance(ours, (str, dict)):
            holds = ours == theirs
        else:
            holds = abs(ours - theirs) <= absolute + relative * max(abs(ours), abs(theirs))
        self.check(holds, f"{name}: {ours} from the trace, {theirs} in the summary")


def rank(values, percent):
    """The least value that the given share does not exceed; values are sorted."""
    return values[max(-(-len(values) * percent // 100), 1) - 1]


def unit(q):
    length = math.sqrt(sum(c * c for c in q))
    return tuple(c / length for c in q)


def surface_error(truth, shown, radius):
    """|dp| + 2 r sin(angle / 2) of two poses (px py pz qx qy qz qw)."""
    distance = math.dist(truth[:3], shown[:3])
    ax, ay, az, aw = unit(truth[3:7])
    bx, by, bz, bw = unit(shown[3:7])
    x = -aw * bx + ax * bw - ay * bz + az * by
    y = -aw * by + ay * bw - az * bx + ax * bz
    z = -aw * bz + az * bw - ax * by + ay * bx
    return distance + 2.0 * radius * min(math.sqrt(x * x + y * y + z * z), 1.0)


class Digest:
    """The server's digest of a truth, over the words of every observation."""

    def __init__(self):
        self.state = 0x7268756D62207631

    def fold(self, word):
        mixed = ((self.state ^ word) * 0x9E3779B97F4A7C15) & MASK
        self.state = mixed ^ (mixed >> 32)


def float_bits(values):
    return array("I", array("f", values).tobytes())


class Grid:
    """Poses of a topic: exact, or second differences of whole steps."""

    def __init__(self):
        self.history = {}

    def poses(self, message, bodies):
        exact = (message.px, message.py, message.pz, message.qx, message.qy, message.qz, message.qw)
        if len(message.px):
            for body in bodies:
                self.history.pop(body, None)
            return zip(*exact)
        return [self.decode(body, residual) for body, residual in zip(bodies, zip(*residuals(message)))]

    def decode(self, body, residual):
        known = self.history.get(body)
        if known is None:
            now = last = residual
        else:
            last, before = known
            now = tuple(r + 2 * a - b for r, a, b in zip(residual, last, before))
        self.history[body] = (now, last)
        return tuple(part / STEPS for part in now)


def residuals(message):
    return (message.step_px, message.step_py, message.step_pz, message.step_qx, message.step_qy, message.step_qz, message.step_qw)


def beside(truth, residual):
    """A pose that differs from the truth's by whole steps."""
    if not any(residual):
        return truth
    return tuple((math.floor(part * STEPS + 0.5) + step) / STEPS for part, step in zip(truth, residual))


class Truth:
    """The engine's bodies, stepped forward by rhumb.States."""

    def __init__(self):
        self.grid, self.exact = Grid(), True
        self.pose, self.config, self.began, self.removed = {}, {}, {}, {}
        self.coming, self.leaving = [], []
        self.digest, self.ticks, self.order = Digest(), 0, True
        self.observed = set()

    def step(self, states):
        """Applies a tick. Placements and removals after a tick take effect at the next; those before the first, at once."""
        self.fold(states)
        self.apply_changes()
        ids = list(zip(states.index, states.generation))
        self.observed = set(ids)
        for body, pose in zip(ids, self.grid.poses(states, ids)):
            self.pose[body] = pose
        for body in zip(states.removed_index, states.removed_generation):
            self.removed[body] = states.tick
            self.leaving.append(body)
        for placed in states.placed:
            body = (placed.index, placed.generation)
            self.config[body] = (states.tick, placed.kind, placed.bounding_radius_m, scale(placed))
            self.began[body] = tuple(placed.motion[:7])
            self.coming.append(body)
        if states.tick == 0:
            self.apply_changes()

    def apply_changes(self):
        self.pose.update((body, self.began[body]) for body in self.coming)
        for body in self.leaving:
            self.pose.pop(body, None)
        self.coming, self.leaving = [], []

    def fold(self, states):
        tick, fold = states.tick, self.digest.fold
        self.order &= tick == self.ticks
        self.ticks += 1
        # Poses on the grid have no bits of the engine.
        self.exact &= len(states.wx) == len(states.index)
        if tick == 0 or not self.exact:
            return
        fold(tick & 0xFFFFFFFF)
        fold(tick >> 32)
        fold(len(states.index))
        columns = [states.px, states.py, states.pz, states.qx, states.qy, states.qz, states.qw]
        columns += [states.vx, states.vy, states.vz, states.wx, states.wy, states.wz]
        bits = [float_bits(column) for column in columns]
        for i, (index, generation) in enumerate(zip(states.index, states.generation)):
            fold(index)
            fold(generation)
            for column in bits:
                fold(column[i])
            fold(int(states.awake[i]))


def scale(placed):
    """Factor of a body's tolerance relative to its run's."""
    return 2.0 ** placed.tolerance_scale


class Run:
    """One mode's run: its counts by frame, its copy, and the errors of that copy."""

    def __init__(self, config):
        self.config = config
        self.stats, self.seen = {}, {}
        self.payload, self.state_bytes = Counter(), 0
        self.breaches = {}
        self.copy, self.errors, self.moving, self.next = {}, [], [], 0
        self.over, self.unjudged, self.miscounted = {}, 0, 0
        self.error_max_wrong = 0
        self.grid, self.rounding_m = Grid(), 0.0

    def add_packet(self, packet):
        if packet.direction in (STATE_DOWN, CONTROL_DOWN):
            self.payload[packet.frame] += packet.length
        if packet.direction == STATE_DOWN:
            self.state_bytes += packet.length

    def advance(self, truth, tick):
        """Shows all frames of this tick in the copy and compares it with the truth."""
        while self.next in self.stats and self.stats[self.next].tick <= tick:
            frame = self.stats[self.next]
            self.show(truth, self.seen.pop(self.next, None))
            self.next += 1
            if frame.body_ticks:
                self.compare(truth, frame)
            else:
                self.unjudged += 1

    def show(self, truth, poses):
        if poses is None:
            return
        for body in zip(poses.gone_index, poses.gone_generation):
            self.copy[body] = None
        bodies = list(zip(poses.index, poses.generation))
        if poses.from_truth:
            for body, residual in zip(bodies, zip(*residuals(poses))):
                self.copy[body] = beside(truth.pose[body], residual)
            return
        for body, pose in zip(bodies, self.grid.poses(poses, bodies)):
            self.copy[body] = pose

    def compare(self, truth, frame):
        tolerance = self.config.get("tolerance_m")
        errors = []
        for body, real in truth.pose.items():
            _, kind, radius, scale = truth.config[body]
            if kind == STATIC:
                continue
            # A body that no frame mentions stands at its placement.
            shown = self.copy.get(body, truth.began[body])
            if shown is None:
                continue
            error = 0.0 if shown == real else surface_error(real, shown, radius)
            errors.append(error)
            if body in truth.observed:
                self.moving.append(error)
            rounding = GRID_M + GRID_M_PER_RADIUS * radius
            self.rounding_m = max(self.rounding_m, rounding)
            if tolerance and error > float(tolerance) * scale + EXACT_M + rounding:
                self.over[frame.tick, *body] = error - float(tolerance) * scale - EXACT_M - rounding
        self.miscounted += len(errors) != frame.body_ticks
        self.error_max_wrong += abs(max(errors, default=0.0) - frame.error_m_max) > self.rounding_m + 1e-6
        self.errors += errors


def read(path):
    """Metadata by name, and every decoded message by topic."""
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        topics = defaultdict(list)
        for _, channel, message, decoded in reader.iter_decoded_messages():
            if not channel.topic.endswith(("/moving", "/resting", "/static")):
                topics[channel.topic].append((message.log_time, decoded))
    return records, topics


def gather(records, topics, load):
    """The runs of a load with their messages."""
    runs = []
    for name, config in records.items():
        if not name.startswith("rhumb.run.") or config["load"] != load:
            continue
        run = Run(config)
        base = f"/{load}/{config['name']}"
        run.stats = {stats.frame: stats for _, stats in topics[f"{base}/stats"]}
        run.seen = {poses.frame: poses for _, poses in topics[f"{base}/seen"]}
        run.breaches = {(b.tick, b.index, b.generation): b for _, b in topics[f"{base}/breaches"]}
        for way in ("state-down", "state-up", "control-down", "control-up"):
            for _, packet in topics[f"{base}/wire/{way}"]:
                run.add_packet(packet)
        runs.append(run)
    return sorted(runs, key=lambda run: int(run.config["place"]))


def replay(topics, load, runs):
    """Steps the engine's bodies and every copy side by side."""
    truth = Truth()
    for _, states in topics[f"/{load}/truth/state"]:
        truth.step(states)
        for run in runs:
            run.advance(truth, states.tick)
    return truth


def worst_second(frames, rate, step_s, ticks):
    """The highest rate over any window of a second, or over the whole run if it is shorter."""
    window = max(min(round(1.0 / step_s), ticks), 1)
    worst, inside, oldest = 0.0, 0, 0
    for frame in frames:
        inside += rate(frame)
        while frames[oldest].tick + window <= frame.tick:
            inside -= rate(frames[oldest])
            oldest += 1
        worst = max(worst, inside * 8e-3 / (window * step_s))
    return worst


def first_seconds(run, frames, down):
    """Traffic down in the first frames."""
    step_s = float(run.config["step_s"]) * int(run.config.get("publish_interval") or 1)
    count = min(math.floor(FIRST_S / step_s + 0.5), len(frames))
    if count == 0:
        return None
    payload = sum(size for frame, size in run.payload.items() if frame < count)
    return {
        "seconds": count * step_s,
        "payload_bytes_down": payload,
        "bytes_down": sum(map(down, frames[:count])),
    }


def check_ratios(report, figures, runs):
    """Reduction of the traffic down against the naive run of the same load."""
    stated = figures["less_than_naive"]
    if stated is None:
        return
    free = figures["mode"].endswith("-free")
    alike = [r for r in runs if r["scene"] == figures["scene"] and r["bodies"] == figures["bodies"]]
    find = lambda mode: [r for r in alike if r["mode"] == mode]
    found = (find("naive-free") if free else []) or find("naive")
    naive = next((r for r in found if r["link"] == figures["link"]), found[0] if found else None)
    report.check(naive is not None, "the naive run of less_than_naive is missing")
    if naive is None:
        return
    ratio = lambda of: of(naive) / of(figures)
    report.same("less_than_naive.payload", ratio(lambda r: r["payload_bytes_down"]), stated["payload"])
    report.same("less_than_naive.with_headers", ratio(lambda r: r["bytes_down"]), stated["with_headers"])
    first = lambda name: ratio(lambda r: r["first_seconds"][name])
    report.same("less_than_naive.payload_first", first("payload_bytes_down"), stated["payload_first"])
    report.same("less_than_naive.with_headers_first", first("bytes_down"), stated["with_headers_first"])


def check_subscription(report, config, figures):
    """Publish and subscribe settings of a free-running scene."""
    stated = figures["subscription"]
    report.same("subscription", config["mode"].endswith("-free"), stated is not None)
    for name in stated or {}:
        report.same(f"subscription.{name}", int(config[name]), stated[name])


def check_replay(report, config, figures):
    """Settings of a replay."""
    stated = figures["replayed"]
    report.same("replayed", config["mode"] == "replay", stated is not None)
    if stated is None:
        return
    for name in ("publish_interval", "lookahead_ticks", "link_seed"):
        report.same(f"replayed.{name}", int(config[name]), stated[name])
    for name in ("position_m", "turn_rad"):
        ours = float(config[name]) if name in config else None
        report.same(f"replayed.{name}", ours, stated[name])
    report.same("replayed.without", config["without"], " ".join(stated["without"]))


def check_costs(report, run, figures, header):
    """Bytes, datagrams, rates and updates."""
    config, frames = run.config, [run.stats[i] for i in range(len(run.stats))]
    seconds = int(config["ticks"]) * float(config["step_s"])
    down = lambda frame: frame.wire_bytes_down + header * frame.wire_datagrams_down
    bytes_down = sum(map(down, frames))
    payload, updates = sum(run.payload.values()), sum(frame.updates for frame in frames)
    worst = worst_second(frames, down, float(config["step_s"]), int(config["ticks"]))
    report.same("bytes_down", bytes_down, figures["bytes_down"])
    up = sum(frame.wire_bytes_up + header * frame.wire_datagrams_up for frame in frames)
    report.same("bytes_up", up, figures["bytes_up"])
    report.same("payload_bytes_down", payload, figures["payload_bytes_down"])
    report.same("datagrams_down", sum(f.wire_datagrams_down for f in frames), figures["datagrams_down"])
    report.same("mean_kbps_down", bytes_down * 8e-3 / seconds, figures["mean_kbps_down"])
    report.same("payload_kbps_down", payload * 8e-3 / seconds, figures["payload_kbps_down"])
    report.same("worst_second_kbps_down", worst, figures["worst_second_kbps_down"])
    report.same("updates", updates, figures["updates"])
    first = first_seconds(run, frames, down)
    for name in first or {}:
        report.same(f"first_seconds.{name}", first[name], figures["first_seconds"][name])
    report.same("first_seconds", first is None, figures["first_seconds"] is None)
    bits = run.state_bytes * 8 / updates if updates else None
    report.same("bits_per_update", bits, figures["bits_per_update"])
    stated = sum(frame.payload_bytes_down for frame in frames)
    last = sum(count for frame, count in run.payload.items() if frame not in run.stats)
    report.same("payload of the stats", stated + last, payload)
    join = {}
    for way in ("down", "up"):
        datagrams = int(config[f"join_wire_datagrams_{way}"])
        join[f"datagrams_{way}"] = datagrams
        join[f"bytes_{way}"] = int(config[f"join_wire_bytes_{way}"]) + header * datagrams
    report.same("join", join, figures["join"])
    steps = int(config["step_ns_total"])
    share = int(config["publish_ns_total"]) / steps if steps else None
    report.same("publish_share", share, figures["publish_share"])


def check_fidelity(report, run, figures):
    """Errors and breaches, from states and poses alone."""
    errors = sorted(run.errors)
    report.same("unjudged_frames", run.unjudged, figures["unjudged_frames"])
    report.check(run.miscounted == 0, f"{run.miscounted} frames have another body count than the trace")
    report.check(run.error_max_wrong == 0, f"{run.error_max_wrong} frames have another largest error")
    if errors:
        for name, percent in (("p50", 50), ("p95", 95), ("p99", 99), ("max", 100)):
            theirs = figures["surface_error_m"][name]
            report.same(f"surface_error_m.{name}", rank(errors, percent), theirs, absolute=run.rounding_m + 1e-6)
    else:
        report.same("surface_error_m", None, figures["surface_error_m"])
    if run.config["mode"] == "replay" and run.moving:
        moving, ours = figures["moving"], sorted(run.moving)
        report.same("moving.body_ticks", len(ours), moving["body_ticks"])
        for name, percent in (("p50", 50), ("p95", 95), ("p99", 99), ("max", 100)):
            theirs = moving["surface_error_m"][name]
            report.same(f"moving.surface_error_m.{name}", rank(ours, percent), theirs, absolute=run.rounding_m + 1e-6)
        share = len(run.breaches) / len(ours)
        report.same("moving.over_tolerance_share", share, moving["over_tolerance_share"])
    over = figures["over_tolerance"]
    causes = Counter(CAUSES[breach.cause] for breach in run.breaches.values())
    report.same("over_tolerance.count", len(run.breaches), over["count"])
    report.same("over_tolerance.share", len(run.breaches) / max(len(errors), 1), over["share"])
    for cause in CAUSES.values():
        report.same(f"over_tolerance.by_cause.{cause}", causes[cause], over["by_cause"].get(cause))
    # Rounding may put a body at the limit on either side.
    missing = run.over.keys() - run.breaches.keys()
    excess = max((run.over[key] for key in missing), default=0.0)
    report.check(excess < 1e-6, f"{len(missing)} breaches are missing in the trace")
    wrong = [b for key, b in run.breaches.items() if b.error_m <= b.tolerance_m]
    report.check(not wrong, f"{len(wrong)} breaches are within tolerance")
    unconfirmed = [b for key, b in run.breaches.items() if key not in run.over and b.error_m > b.tolerance_m + EXACT_M + 2 * run.rounding_m + 1e-6]
    report.check(not unconfirmed, f"{len(unconfirmed)} breaches are not confirmed by the poses")


def check_times(report, run, figures):
    """Frame and step times."""
    config = run.config
    times = sorted(frame.frame_ns for frame in run.stats.values())
    mean = sum(times) / len(times)
    report.same("frame_ms.p50", rank(times, 50) / 1e6, figures["frame_ms"]["p50"])
    report.same("frame_ms.p99", rank(times, 99) / 1e6, figures["frame_ms"]["p99"])
    report.same("frame_ms.mean", mean / 1e6, figures["frame_ms"]["mean"])
    report.same("sim_fps", min(1e9 / mean, SIM_FPS_MAX), figures["sim_fps"])
    for name in ("p50", "p99"):
        report.same(f"step_ms.{name}", int(config[f"step_ns_{name}"]) / 1e6, figures["step_ms"][name])


def check_run(report, run, figures, header):
    """Every figure of one run."""
    config = run.config
    for name in ("scene", "mode"):
        report.same(name, config[name], figures[name])
    for name in ("bodies", "depth", "ticks"):
        report.same(name, int(config[name]), figures[name])
    tolerance = config.get("tolerance_m")
    report.same("tolerance_m", None if tolerance is None else float(tolerance), figures["tolerance_m"])
    budget = config.get("budget_bytes_per_second")
    report.same("budget_bytes_per_second", None if budget is None else int(budget), figures["budget_bytes_per_second"])
    report.same("truth_hash", config["truth_hash"], figures["truth_hash"])
    report.same("frames", int(config["frames"]), len(run.stats))
    check_subscription(report, config, figures)
    check_replay(report, config, figures)
    report.check(run.next == len(run.stats), "some frames show a tick that the engine never simulated")
    if run.stats and config["mode"] != "replay":
        check_times(report, run, figures)
    if config["mode"] == "integrated":
        for name in ("bytes_down", "bytes_up", "updates", "surface_error_m", "over_tolerance", "mismatches", "join", "link"):
            report.same(name, None, figures[name])
        return
    report.same("link", config["link"] or None, figures["link"])
    report.same("mismatches", int(config["mismatches"]), figures["mismatches"])
    check_costs(report, run, figures, header)
    check_fidelity(report, run, figures)


def check_truth(report, truth, record, runs):
    """Checks that the engine's states are complete and equal for every run."""
    report.check(truth.order, "a tick of the engine is missing")
    report.same("ticks of the engine", truth.ticks - 1, int(record["ticks"]))
    report.same("bodies placed", len(truth.config), int(record["placed"]))
    report.same("bodies removed", len(truth.removed), int(record["removed"]))
    for run in runs:
        report.same(f"truth of {run.config['name']}", run.config["truth_hash"], record["truth_hash"])
    # The truth of a free-running scene comes from its full stream, which carries no sleep flags. Loads after the first
    # have poses on the grid.
    if truth.exact and any(not run.config["mode"].endswith("-free") for run in runs):
        report.same("digest of the states", f"{truth.digest.state:016x}", record["truth_hash"])


def must_read(reads, path):
    """Reads a file, or ends the program with an error that names it."""
    try:
        return reads(path)
    except OSError as cause:
        sys.exit(f"error: {path}: {cause.strerror}")
    except Exception as cause:  # The libraries raise various exceptions for invalid files.
        sys.exit(f"error: {path} cannot be read: {type(cause).__name__}: {cause}")


def read_figures(path):
    with open(path, encoding="utf-8") as file:
        figures = json.load(file)
    for name in ("command", "machine", "seed", "runs"):
        figures[name]
    return figures


def main(trace, summary):
    figures = must_read(read_figures, summary)
    records, topics = must_read(read, trace)
    if "rhumb.experiment" not in records:
        sys.exit(f"error: {trace} has no record of an experiment")
    report, experiment = Report(), records["rhumb.experiment"]
    report.where = "experiment"
    for name in ("command", "machine"):
        report.same(name, experiment[name], figures[name])
    report.same("seed", experiment["seed"], str(figures["seed"]))
    header, count = int(experiment["datagram_header_bytes"]), 0
    for load in experiment["loads"].split():
        runs = gather(records, topics, load)
        truth = replay(topics, load, runs)
        report.where = load
        if runs:
            check_truth(report, truth, records[f"rhumb.truth.{load}"], runs)
        for run in runs:
            report.where = f"{load} {run.config['name']}"
            own = figures["runs"][int(run.config["place"])]
            check_run(report, run, own, header)
            check_ratios(report, own, figures["runs"])
            void = run.config["truth_hash"] != records[f"rhumb.truth.{load}"]["truth_hash"]
            report.same("void", void, own["void"])
        count += len(runs)
    report.where = "experiment"
    report.same("runs", count, len(figures["runs"]))
    moments = sum(run["bodies"] * run["ticks"] for run in figures["runs"])
    size = os.path.getsize(trace)
    report.check(size <= OVERHEAD_BYTES + MOMENT_BYTES * moments, f"{size} bytes for {moments} moments of a body")
    print(f"{report.passed} passed, {report.failed} failed")
    return 1 if report.failed else 0


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1], sys.argv[2]))
