"""Runs subscriber.py over the golden streams: after each tick and each loss it must have the recorded state.

Usage: python3 check_streams.py. Prints failures, then a count; the exit code is 1 after a failure.
"""

import json
import sys
from pathlib import Path

import messages
import subscriber

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


def poses(scene):
    """FNV-1a over the bits of each body's predicted motion at the complete tick, in order of index."""
    h = 0xCBF29CE484222325
    for index in sorted(scene.bodies):
        motion = scene.predicted_motion(scene.bodies[index], scene.watermark)
        for byte in subscriber.bits64(motion.numbers()):
            h = (h ^ byte) * 0x100000001B3 & subscriber.MASK
    return f"{h:016x}"


def known(scene, with_poses):
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
    # The displayed state of a body with a checksum mismatch is not specified (6.8).
    return state | ({"poses": poses(scene)} if with_poses else {})


def results(stream):
    """Each recorded state of a stream's member, and the state of this one."""
    member = Member()
    for place, (what, value) in enumerate(stream["events"]):
        if what == "control":
            member.receive_control(bytes.fromhex(value))
        elif what == "datagram" and member.scene:
            member.scene.receive_datagram(bytes.fromhex(value))
        elif what == "known":
            want = dict(value)
            if not want["converged"]:
                del want["poses"]
            yield f"{stream['name']}, event {place}", want, known(member.scene, want["converged"])
    yield f"{stream['name']}, checksums that differ", 0, member.scene.checksum_mismatches


def main():
    passed, failed = 0, 0
    vectors = json.loads((SPEC / "vectors" / "streams.json").read_text(encoding="utf-8"))
    for stream in vectors["streams"]:
        for name, want, got in results(stream):
            passed += want == got
            failed += want != got
            if want != got and failed < 40:
                print(f"{name}: expected {want}, got {got}")
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
