"""The server's end of an upstream (PROTOCOL 6.14): motions of bodies under a member's authority.

It receives datagrams; it sends no loss reports, and moves nothing in an engine.
"""

import packets
import reckoning
import subscriber
from messages import LIMITS, motion_of, to_f32

NAMES_END = 2 * LIMITS["AUTHORITY_BODIES_MAX"]


class Upstream(subscriber.Scene):
    """The tracks of the bodies of an `AuthorityGrant`. `descs` are their descriptions, in its order."""

    def __init__(self, grant, config, choice, shapes, descs, largest_packet):
        joined = {"choice": choice, "config": config | {"publish interval": 1}, "stream": grant["stream"], "gravity": ["00000000"] * 3}
        joined |= {"tick": grant["tick"], "next": 0, "events": 0, "granted": None, "largest packet": largest_packet}
        super().__init__(joined)
        self.shapes, self.newest_packet = shapes, grant["tick"]
        for index, (granted, desc) in enumerate(zip(grant["bodies"], descs)):
            desc = desc | {"id": {"index": index, "generation": 0}}
            self.bodies[index] = subscriber.Body(desc, None, first_track(grant["tick"], motion_of(granted["motion"])), self)
        self.tracks = {index: [body.track] for index, body in self.bodies.items()}
        self.placed = {}
        self.end_snapshot()

    def receive_datagram(self, data):
        try:
            msg = packets.decoded(data)
        except packets.Malformed:
            return
        if msg["kind"] in (4, 5) or msg.get("events") or not all(fits(one) for one in msg.get("updates", []) + msg.get("records", [])):
            return
        super().receive_datagram(data)
        for index, body in self.bodies.items():
            if body.track is not self.tracks[index][-1]:
                kept = [track for track in self.tracks[index] if track.origin < body.track.origin]
                self.tracks[index] = [*kept, body.track]

    def receive_packet(self, msg, tick, rebuilt):
        super().receive_packet(msg, tick, rebuilt)
        self.newest_packet = max(self.newest_packet, tick)

    def trusted(self):
        """6.14-14: the last tick of prediction."""
        rate = self.config["ticks"] / self.config["seconds"]
        least, most, grace = (int(LIMITS[name] * rate / 1000) for name in ("UPSTREAM_WATERMARK_MS", "SILENCE_MS_MAX", "UPSTREAM_GRACE_MS"))
        silence = self.watermark - self.newest_packet
        return self.watermark + min(max(silence, least, 1), max(most, 1)) + grace

    def motion(self, index, tick):
        """The motion of a body in the step to a tick (6.14-12)."""
        at = min(tick, self.trusted())
        track = [track for track in self.tracks[index] if track.origin <= at][-1]
        motion = self.own(self.bodies[index], track, at)
        if tick > at:
            motion = stilled(motion)
        return motion

    def step(self, index, tick):
        """The motion that a body gets in the step to a tick: one that would leave the limits stays where it was (6.14-13)."""
        motion = self.motion(index, tick)
        if all(abs(to_f32(part)) <= LIMITS["COORDINATE_MAX"] for part in motion.position):
            self.placed[index] = motion
            return motion
        return stilled(self.placed.get(index, motion))


def stilled(motion):
    return reckoning.Motion(motion.position, motion.rotation, (0.0,) * 3, (0.0,) * 3)


def first_track(tick, motion):
    """6.14-3"""
    at_rest = all(part == "00000000" for part in motion[7:])
    return subscriber.Track(tick, "rest" if at_rest else "uniform", motion)


def fits(one):
    """6.14-6: whether an update or a record is one of an upstream."""
    names = (one.get("alias") or 0, one.get("body") or 0, one.get("index", 0))
    attached = one.get("mode") == "attached" or one.get("parent_age") is not None or one.get("keyframe", {}).get("parent")
    return max(names) < NAMES_END and not attached
