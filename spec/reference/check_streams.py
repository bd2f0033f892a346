"""Runs subscriber.py over the golden streams: after each tick and each loss it must have the recorded state.

Usage: python3 check_streams.py. Prints failures, then a count; the exit code is 1 after a failure.
"""

import json
import sys
from pathlib import Path

import messages
import subscriber
import upstream

SPEC = Path(__file__).resolve().parent.parent


class Member:
    """A member that only receives."""

    def __init__(self):
        self.frames, self.scene = messages.Frames(), None

    def receive_control(self, data):
        self.frames.push(data)
        while (message := self.frames.next()) is not None:
            msg = messages.decoded("server", *message)
            if msg is not None:
                self.receive(msg)

    def receive(self, msg):
        if msg["is"] == "Joined":
            self.scene = subscriber.Scene(msg)
        elif msg["is"] == "SceneEvent":
            self.scene.receive_scene_event(msg["event"])
        elif msg["is"] == "SnapshotEnd":
            self.scene.end_snapshot()


def hashed(motions):
    """FNV-1a over the bits of motions."""
    h = 0xCBF29CE484222325
    for motion in motions:
        for byte in subscriber.bits64(motion.numbers()):
            h = (h ^ byte) * 0x100000001B3 & subscriber.MASK
    return f"{h:016x}"


def poses(scene):
    """Each body's predicted motion at the watermark, in order of index."""
    return hashed(scene.predicted_motion(scene.bodies[index], scene.watermark) for index in sorted(scene.bodies))


def known(scene):
    state = {
        "watermark": scene.watermark,
        "complete": scene.complete(),
        "converged": scene.is_converged(),
        "next": scene.next & 0xFFFF,
        "missing": len(scene.missing),
        "checksum": f"{scene.sum():016x}",
    }
    if scene.capped:
        state["error_scale_eighths"] = scene.error_scale(scene.watermark)
    # The pose of a body while something is missing is not specified (6.8).
    return state | ({"poses": poses(scene)} if scene.is_converged() else {})


def known_in_full(scene):
    """The words of a scripted stream: all of the state that another end or an application can observe."""
    state, report = known(scene), scene.loss_report()
    state |= {"abandoned": report["abandoned"], "lost": report["lost"], "resync": scene.resync()}
    if scene.capped:
        state["error_scales"] = [scene.error_scale(tick) for tick in recent(scene.watermark, 6)]
    return state | {"bodies": [body_row(scene, scene.bodies[index]) for index in sorted(scene.bodies)]}


def recent(tick, count):
    """The tick after one, that one, and some before it, newest first."""
    return range(tick + 1, max(tick - count, -1), -1)


def body_row(scene, body):
    """Index, generation, origin, the ticks about the watermark at which the error is known, and the motions at these."""
    ticks = [tick for tick in recent(scene.watermark, 4) if scene.is_within(body, tick)]
    motions = hashed(scene.predicted_motion(body, tick) for tick in ticks)
    return [body.index, body.generation, body.track.origin, ticks, motions]


def upstream_known(scene, tick):
    """The words of an upstream: what the server has in the step to a tick."""
    motions = [hashed([scene.step(index, tick)]) for index in sorted(scene.bodies)]
    return {"watermark": scene.watermark, "lost touch": scene.lost_sync, "bodies": motions}


# The scene of every upstream of the vectors: kinematic balls.
CONFIG = {"ticks": 60, "seconds": 1, "substeps": 4, "damping": {"linear": "00000000", "angular": "00000000"}}
BALL, DESC = {"is": "ball", "radius": "3f000000"}, {"flags": 2, "shape": 0}
LARGEST = messages.LIMITS["DATAGRAM_BYTES_MAX"]
WITHIN = {"is": "within a surface tolerance", "micrometres": 5000}


def upstream_results(stream):
    """As `results`, of the server's end of an upstream."""
    stated = [(place, event[2]) for place, event in enumerate(stream["events"]) if event[0] == "step"]
    for (place, known), reported_state in zip(stated, upstream_states(stream["events"])):
        yield f"{stream['name']}, event {place}", known, reported_state


def upstream_states(events):
    """The state of the server's end of an upstream at each step."""
    scene, lockstep, sent = None, False, messages.Frames()
    for what, value, *more in events:
        if what == "grant":
            frames = messages.Frames()
            frames.push(bytes.fromhex(value))
            grant = messages.decoded("server", *frames.next())
            scene = upstream.Upstream(grant, CONFIG, WITHIN, {0: BALL}, [DESC] * len(grant["bodies"]), LARGEST)
            lockstep = more == ["lockstep"]
        elif what == "datagram":
            if not lockstep:
                scene.receive_datagram(bytes.fromhex(value))
        elif what == "control":
            sent.push(bytes.fromhex(value))
            while (message := sent.next()) is not None:
                msg = messages.decoded("client", *message)
                if lockstep and msg["is"] == "Upstream":
                    scene.receive_datagram(bytes.fromhex(msg["packet"]))
        else:
            yield upstream_known(scene, value)


def results(stream):
    """Each stated state of a stream's member, and the state of this one."""
    member = Member()
    for place, (what, value) in enumerate(stream["events"]):
        if what == "control":
            member.receive_control(bytes.fromhex(value))
        elif what == "datagram" and member.scene:
            member.scene.receive_datagram(bytes.fromhex(value))
        elif what == "known":
            yield f"{stream['name']}, event {place}", value, reported(member.scene, value)


def reported(scene, value):
    """The member's state in the words of a stated one."""
    state = known_in_full(scene) if "bodies" in value else known(scene)
    state |= {"requests": scene.requests()} if "requests" in value else {}
    return state | ({"joints": sorted(scene.joints)} if "joints" in value else {})


def main():
    passed, failed = 0, 0
    for file in ("streams.json", "scripted.json"):
        vectors = json.loads((SPEC / "vectors" / file).read_text(encoding="utf-8"))
        both = [results(stream) for stream in vectors["streams"]] + [upstream_results(stream) for stream in vectors.get("upstreams", [])]
        for name, want, got in (result for each in both for result in each):
            passed += want == got
            failed += want != got
            if want != got and failed < 40:
                print(f"{name}: expected {want}, got {got}")
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
