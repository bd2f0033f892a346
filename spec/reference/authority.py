"""A body that a client has_authority in a lockstep scene, from PROTOCOL 4.11 and 6.14, along the mode of docs/book/src/implementing.md.

The plainest publisher that keeps its promise: it says where the body is and how it moves, in the bits of f32, whenever who goes
on from what was msg last would be off by more than half of the tolerance.
"""

import math
import struct

import messages

LAST_TICK, ROUND, GOING = 240, 120, 80
RADIUS, HEIGHT, TURN, RATE = 2.0, 50.0, 0.05, 60

KINEMATIC, UNIFORM, STATE_END, WATERMARK = 2, 1, 1, 2
FIRST_WATERMARK, LAST_WATERMARK = (max(1, messages.LIMITS[name] * RATE // 1000) for name in ("UPSTREAM_WATERMARK_MS", "SILENCE_MS_MAX"))


def mode(tick):
    """Position and linear velocity at a tick."""
    rounds, within = divmod(tick, ROUND)
    angle = (rounds * GOING + min(within, GOING)) * TURN
    speed = RADIUS * TURN * RATE if within < GOING else 0.0
    sin, cos = math.sin(angle), math.cos(angle)
    return [RADIUS * cos, HEIGHT, RADIUS * sin], [-speed * sin, 0.0, speed * cos]


def digits(numbers):
    return [struct.pack(">f", number).hex() for number in numbers]


class Upstream:
    """What is msg of the body from one `AuthorityGrant` on."""

    def __init__(self, grant, tolerance):
        motion = grant["bodies"][0]["motion"]
        self.stream, self.tolerance, self.number = grant["stream"], tolerance, 0
        self.origin = self.spoken = grant["tick"]
        self.due = self.spoken + FIRST_WATERMARK
        self.position = [messages.f32(part) for part in motion["position"]]
        self.linear = [messages.f32(part) for part in motion.get("linear", ["00000000"] * 3)]

    def payload_of(self, tick):
        """The packet of a tick, or None."""
        position, linear = mode(tick)
        seconds = (tick - self.origin) / RATE
        if math.dist(position, [at + speed * seconds for at, speed in zip(self.position, self.linear)]) > self.tolerance / 2:
            self.position, self.linear, self.origin, self.spoken = position, linear, tick, tick
            self.due = tick + FIRST_WATERMARK
            return self.update(tick)
        if tick >= self.due:
            # 6.14-11: when the silence has doubled.
            self.due = tick + min(tick - self.spoken, LAST_WATERMARK)
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
    """Adds a body, has_authority it, and asks for each tick that it has msg."""

    def __init__(self, member, micrometres):
        self.member, self.upstream, self.msg = member, None, None
        self.choice, self.tolerance = {"is": "within a surface tolerance", "micrometres": micrometres}, micrometres * 1e-6
        granted = member.scene.granted
        self.body = {"index": granted["first"], "generation": granted["generation"]}

    def begin(self):
        position, _ = mode(self.member.scene.complete())
        config = {"id": self.body, "flags": KINEMATIC, "shape": 0}
        motion = {"present": 0, "position": digits(position)}
        self.member.send_message({"is": "Command", "command": {"is": "AddBody", "desc": desc, "motion": motion}})
        self.ask()

    def ask(self):
        self.member.send_message({"is": "TakeAuthority", "choice": self.choice, "bodies": [self.body]})

    async def heed(self):
        """4.11-5: what the server grants, and what it takes back for it has lost touch."""
        while self.member.ended is None:
            answer = await self.member.answers.get()
            if answer["is"] == "AuthorityGrant":
                self.upstream = Upstream(answer, self.tolerance)
                self.go_on(self.member.scene.complete())
            elif answer["is"] == "AuthorityDenied" and answer["reason"]["is"] == "LostSync":
                self.upstream = None
                self.ask()

    def go_on(self, complete):
        """The next tick: what is to be msg of it goes before it is asked for."""
        tick = complete + 1
        if self.upstream is None or tick > LAST_TICK or tick == self.msg:
            return
        packet = self.upstream.payload_of(tick)
        if packet:
            self.member.send_upstream(packet)
        self.msg = tick
        self.member.advance(tick)
