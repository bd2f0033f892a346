"""A body under client authority in a lockstep scene (PROTOCOL 4.11, 6.14), on the trajectory of docs/book/src/implementing.md.

The simplest publisher that keeps its promise: it publishes position and velocity, as exact f32s, whenever a prediction
from the last published state has an error above half of the tolerance.
"""

import math
import struct

import messages

LAST_TICK, ROUND, GOING = 240, 120, 80
RADIUS, HEIGHT, TURN, RATE = 2.0, 50.0, 0.05, 60

KINEMATIC, UNIFORM, STATE_END, WATERMARK = 2, 1, 1, 2
FIRST_WATERMARK, LAST_WATERMARK = (max(1, messages.LIMITS[name] * RATE // 1000) for name in ("UPSTREAM_WATERMARK_MS", "SILENCE_MS_MAX"))


def trajectory(tick):
    """Position and linear velocity of the body at a tick."""
    rounds, within = divmod(tick, ROUND)
    angle = (rounds * GOING + min(within, GOING)) * TURN
    speed = RADIUS * TURN * RATE if within < GOING else 0.0
    sin, cos = math.sin(angle), math.cos(angle)
    return [RADIUS * cos, HEIGHT, RADIUS * sin], [-speed * sin, 0.0, speed * cos]


def digits(numbers):
    return [struct.pack(">f", number).hex() for number in numbers]


class Upstream:
    """The packets of the body after one `AuthorityGrant`."""

    def __init__(self, grant, tolerance):
        motion = grant["bodies"][0]["motion"]
        self.stream, self.tolerance, self.number = grant["stream"], tolerance, 0
        self.origin = self.last_update = grant["tick"]
        self.due = self.last_update + FIRST_WATERMARK
        self.position = [messages.f32(part) for part in motion["position"]]
        self.linear = [messages.f32(part) for part in motion.get("linear", ["00000000"] * 3)]

    def payload_of(self, tick):
        """The packet of a tick, or None if none is needed."""
        position, linear = trajectory(tick)
        seconds = (tick - self.origin) / RATE
        if math.dist(position, [at + speed * seconds for at, speed in zip(self.position, self.linear)]) > self.tolerance / 2:
            self.position, self.linear, self.origin, self.last_update = position, linear, tick, tick
            self.due = tick + FIRST_WATERMARK
            return self.update(tick)
        if tick >= self.due:
            # 6.14-11: a watermark is due when the silence has doubled.
            self.due = tick + min(tick - self.last_update, LAST_WATERMARK)
            return self.head(WATERMARK, tick) | {"next": self.number % 65536}
        return None

    def update(self, tick):
        numbers = digits([*self.position, 0.0, 0.0, 0.0, 1.0, *self.linear, 0.0, 0.0, 0.0])
        keyframe = {"predictor": UNIFORM, "parent": None, "body_state": numbers}
        packet = self.head(STATE_END, tick) | {"number": self.number % 65536}
        self.number += 1
        return packet | {"updates": [{"alias": 0, "body": 0, "keyframe": keyframe}]}

    def head(self, kind, tick):
        return {"kind": kind, "stream": self.stream, "tick": tick % 65536, "events": 0}


class Authority:
    """Adds a body, takes authority over it, and requests each tick that it has published."""

    def __init__(self, member, micrometres):
        self.member, self.upstream, self.published = member, None, None
        self.choice, self.tolerance = {"is": "within a surface tolerance", "micrometres": micrometres}, micrometres * 1e-6
        granted = member.scene.granted
        self.body = {"index": granted["first"], "generation": granted["generation"]}

    def begin(self):
        position, _ = trajectory(self.member.scene.complete())
        desc = {"id": self.body, "flags": KINEMATIC, "shape": 0}
        motion = {"present": 0, "position": digits(position)}
        self.member.send_message({"is": "Command", "command": {"is": "AddBody", "desc": desc, "motion": motion}})
        self.ask()

    def ask(self):
        self.member.send_message({"is": "TakeAuthority", "choice": self.choice, "largest packet": 1100, "bodies": [self.body]})

    async def handle_answers(self):
        """4.11-5: handles grants, and requests authority again after it was withdrawn."""
        while self.member.ended is None:
            answer = await self.member.answers.get()
            if answer["is"] == "AuthorityGrant":
                self.upstream = Upstream(answer, self.tolerance)
                self.publish_next(self.member.scene.complete())
            elif answer["is"] == "AuthorityDenied" and answer["reason"]["is"] == "LostSync":
                self.upstream = None
                self.ask()

    def publish_next(self, complete):
        """Publishes the state of the next tick, then requests that tick."""
        tick = complete + 1
        if self.upstream is None or tick > LAST_TICK or tick == self.published:
            return
        packet = self.upstream.payload_of(tick)
        if packet:
            self.member.send_upstream(packet)
        self.published = tick
        self.member.advance(tick)
