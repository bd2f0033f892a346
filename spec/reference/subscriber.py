"""A member's copy of a scene (PROTOCOL 6): tracks, gaps, refreshes, aliases, gravity, scene events.

It receives messages and datagrams, and sends nothing by itself. It is meant for reading beside the document.
"""

import struct
from dataclasses import dataclass, replace

import packets
import reckoning
from messages import LIMITS, f32, flat, motion_of
from fec_decoder import Decoder

PREDICTORS = ("rest", "uniform", "ballistic", "torque_free", "ballistic_torque_free", "constant_acceleration")
HISTORY, JUMP, PENDING_MAX = LIMITS["HISTORY_PACKETS"], LIMITS["TICK_JUMP_MAX"], LIMITS["WAITING_DATAGRAMS_MAX"]
UNREADABLE, NO_SUCH_PARENT_TRACK = "unreadable", "no such parent track"
IDENTITY = ["00000000", "00000000", "00000000", "3f800000"]


class Violation(Exception):
    """The server contradicts itself; the argument is the close code."""


# 6.1 Tracks


@dataclass
class Track:
    origin: int
    predictor: str
    anchor: object  # reckoning.Quantised, or a list of thirteen f32s as digits
    parent: tuple = None  # index, generation
    acceleration: reckoning.Acceleration = None  # of the accelerated predictor

    def is_exact_rest(self):
        return self.predictor == "rest" and isinstance(self.anchor, list)


def track_of_keyframe(origin, keyframe):
    """5.5"""
    predictor, parent = PREDICTORS[keyframe["predictor"]], keyframe["parent"]
    if "body_state" in keyframe:
        anchor = keyframe["body_state"]
    else:
        rotation = (keyframe["largest"], tuple(keyframe["others"]))
        anchor = reckoning.Quantised(tuple(keyframe["position"]), rotation, tuple(keyframe["linear"]), tuple(keyframe["angular"]))
    return Track(origin, predictor, anchor, tuple(parent) if parent else None, acceleration_of(keyframe))


def acceleration_of(msg):
    """The acceleration of a keyframe or an update."""
    return reckoning.Acceleration.of(msg["acceleration"]["steps"], msg["acceleration"]["exponent"]) if "acceleration" in msg else None


def track_of_scene_event(msg):
    """4.6"""
    if msg["payload"]["is"] == "packed":
        bits = packets.BitReader(bytes.fromhex(msg["payload"]["keyframe"]))
        return track_of_keyframe(msg["origin"], packets.read_keyframe(bits))
    return Track(msg["origin"], msg["payload"]["is"], motion_of(msg["payload"]["anchor"]))


class Body:
    """A body with its prediction parameters and tracks."""

    def __init__(self, config, inertia, track, scene):
        self.index, self.generation = config["id"]["index"], config["id"]["generation"]
        dynamic = config["flags"] & 3 == 1
        damping = config.get("damping", scene.config["damping"])
        still = {"linear": "00000000", "angular": "00000000"}
        self.flow = scene.flow(damping if dynamic else still)
        self.scale = f32(config.get("gravity scale", "3f800000")) if dynamic else 0.0
        self.tolerance_scale = config.get("tolerance scale", 0)
        self.grid = scene.grid(radius_of(scene.shapes[config["shape"]]), self.tolerance_scale)
        self.inertia = None
        if inertia and inertia["is"] != "none":
            moments = [f32(part) for part in inertia["moments"]]
            self.inertia = reckoning.Inertia.of(moments, [f32(part) for part in inertia.get("frame", IDENTITY)])
        self.track, self.before = track, None

    def moved(self, track, tick, gravity):
        """The motion of one of its tracks at a tick, in the frame of the track (RECKONING 3.1)."""
        if isinstance(track.anchor, list):
            start = reckoning.body_state_motion([f32(part) for part in track.anchor])
        else:
            start = track.anchor.motion(self.grid)
        elapsed = reckoning.elapsed_ticks(tick, track.origin)
        gravity_pull = reckoning.gravity_of(gravity, self.scale)
        return reckoning.predicted(track.predictor, start, elapsed, gravity_pull, self.flow, self.inertia, track.acceleration)


EXTENTS = ("half extents", "half height", "radius", "normal", "points", "row spacing", "column spacing", "heights")


def radius_of(shape):
    """RECKONING 4.5"""
    if shape["is"] == "compound":
        balls = ((*[f32(x) for x in part["position"]], radius_of(part["shape"])) for part in shape["parts"])
        return reckoning.bounding_radius("compound", [one for ball in balls for one in ball])
    extents = [f32(one) for name in EXTENTS if name in shape for one in flat(shape[name])]
    return reckoning.bounding_radius(shape["is"], extents, shape.get("rows"))


# 5.7 Low 16 bits


def expanded(low, expected):
    count = expected - ((expected - low) & 0xFFFF)
    if count < 0 or expected - count >= 0x8000:
        count += 0x10000
    return count


# 6.12 StateChecksum

MASK = (1 << 64) - 1
F = 0x9E3779B97F4A7C15


def mix(h, w):
    p = (h ^ w) * F & MASK
    return p ^ (p >> 32)


def pair(a, b):
    return (a & 0xFFFFFFFF) | (b & 0xFFFFFFFF) << 32


def checksums(body):
    track = body.track
    h = mix(F, pair(body.index, body.generation))
    h = mix(h, track.origin)
    if track.parent:
        h = mix(h, pair(*track.parent))
    predictor = PREDICTORS.index(track.predictor)
    if isinstance(track.anchor, list):
        numbers = [int(part, 16) for part in track.anchor] + [0]
        words = [2 * predictor + 1] + [pair(a, b) for a, b in zip(numbers[::2], numbers[1::2])]
    else:
        x, y, z = track.anchor.position
        largest, (a, b, c) = track.anchor.rotation
        u, v, w = track.anchor.linear
        p, q, r = track.anchor.angular
        words = [2 * predictor, pair(x, y), pair(z, largest), pair(a, b), pair(c, u), pair(v, w), pair(p, q), pair(r, 0)]
    if track.acceleration:
        x, y, z = track.acceleration.steps
        words += [pair(x, y), pair(z, track.acceleration.exponent)]
    for word in words:
        h = mix(h, word)
    return h


class Scene:
    """A member's copy of its scene, from one stream."""

    def __init__(self, joined):
        self.choice, self.config, self.stream = joined["choice"], joined["config"], joined["stream"]
        self.largest_packet = joined["largest packet"]
        # A choice with a budget has the tracks of its inner choice; only the stated error scale is additional.
        self.capped = self.choice["is"] == "within a budget"
        self.choice = self.choice["choice"] if self.capped else self.choice
        self.statements = ErrorScaleLog(joined["next"], joined["tick"])
        self.flows, self.shapes, self.bodies, self.joints = {}, {}, {}, {}
        self.gravities = [(0, [f32(part) for part in joined["gravity"]])]
        self.snapshot_gravity = False
        self.has_snapshot, self.scene_events, self.next = False, joined["events"], joined["next"]
        self.start = joined["tick"]
        self.watermark = self.newest = self.converged_at = self.start
        self.known_from = 0
        self.aliases, self.alias_of = {}, {}  # alias: (index or None, since); index: alias
        self.missing, self.unread, self.pending = {}, {}, []
        self.first, self.arrived = joined["next"], set()  # the numbers of packets that were read as they arrived
        self.received = {}  # state packets, by number, with their ticks
        self.decoder = Decoder(self.stream, joined["next"])
        self.lost_sync, self.checksum_mismatches, self.granted = False, 0, joined["granted"]

    def flow(self, damping):
        config = self.config
        key = (damping["linear"], damping["angular"])
        if key not in self.flows:
            dampings = [f32(part) for part in key]
            self.flows[key] = reckoning.Flow(config["ticks"], config["seconds"], config["substeps"], *dampings)
        return self.flows[key]

    def grid(self, radius, tolerance_scale):
        choice = self.choice
        # A full stream has no quantised values.
        length = reckoning.scaled_tolerance(choice.get("micrometres", 1000), tolerance_scale, 1000, 10000000)
        turn = choice.get("microradians")
        return reckoning.Grid.of(length, radius, turn and reckoning.scaled_tolerance(turn, tolerance_scale, 100, 3141593))

    def gravity(self, origin):
        """6.9"""
        return [gravity_pull for since, gravity_pull in self.gravities if since <= origin][-1]

    # Prediction

    def own(self, body, track, tick):
        return body.moved(track, tick, self.gravity(track.origin))

    def parent(self, track):
        """The parent of a track's body, if it still exists."""
        body = self.bodies.get(track.parent[0]) if track.parent else None
        return body if body and body.generation == track.parent[1] else None

    def track_at(self, body, tick):
        """The track of a body that holds at a tick, as far as it is here."""
        before = body.before
        if body.track.origin > tick and before and before.origin <= tick:
            return before
        return body.track

    def predicted_motion(self, body, tick):
        """RECKONING 3.8"""
        track = self.track_at(body, tick)
        motion, parent = self.own(body, track, tick), self.parent(track)
        if parent is None:
            return motion
        return reckoning.attached_motion(self.own(parent, self.track_at(parent, tick), tick), motion)

    # 4.6, 4.8 SceneEvents

    def receive_scene_event(self, msg):
        name = msg["is"]
        if name == "ShapeAdded":
            self.shapes[msg["id"]] = msg["shape"]
        elif name == "ShapeRemoved":
            self.must(msg["id"] in self.shapes)
            del self.shapes[msg["id"]]
        elif name == "BodyPlaced":
            self.place(msg)
        elif name == "BodyRemoved":
            body = self.bodies.get(msg["id"]["index"])
            self.must(body and body.generation == msg["id"]["generation"])
            self.leave(body.index)
            del self.bodies[body.index]
            self.part(msg["id"])
        elif name == "GravityChanged":
            gravity_pull = [f32(part) for part in msg["gravity"]]
            if not self.has_snapshot and not self.snapshot_gravity:
                self.gravities, self.snapshot_gravity = [], True
            self.gravities = [old for old in self.gravities if old[0] < msg["tick"]] + [(msg["tick"], gravity_pull)]
        elif name in ("PublisherSilent", "PublisherActive"):
            self.must_know(msg["bodies"])
        elif name == "JointAdded":
            self.must_know((msg["joint"]["first"], msg["joint"]["second"]))
            self.joints[msg["id"]] = msg["joint"]
        elif name == "JointRemoved":
            self.must(msg["id"] in self.joints)
            del self.joints[msg["id"]]
        if self.has_snapshot:
            self.scene_events += 1
            self.release()

    def must_know(self, ids):
        for id_ in ids:
            body = self.bodies.get(id_["index"])
            self.must(body and body.generation == id_["generation"])

    def must(self, good):
        if not good:
            raise Violation(2)

    def part(self, id_):
        """4.6-2: removing a body removes its joints too."""
        joints = self.joints.items()
        self.joints = {name: joint for name, joint in joints if id_ not in (joint["first"], joint["second"])}

    def place(self, msg):
        self.must(msg["desc"]["shape"] in self.shapes)
        body = Body(msg["desc"], msg.get("inertia"), track_of_scene_event(msg["track"]), self)
        self.leave(body.index)
        before = self.bodies.get(body.index)
        if before and before.generation != body.generation:
            self.part({"index": before.index, "generation": before.generation})
        self.bodies[body.index] = body
        if msg["alias"]:
            self.assign_alias(msg["alias"] - 1, body.index, self.newest)

    def end_snapshot(self):
        self.has_snapshot = True
        self.release()

    # 6.13 Aliases

    def leave(self, index):
        alias = self.alias_of.pop(index, None)
        if alias is not None:
            self.aliases[alias] = (None, self.since(alias))

    def assign_alias(self, alias, index, tick):
        """6.13-7."""
        body, there = self.bodies.get(index), self.alias_of.get(index)
        moved_on = body is None or body.track.origin > tick
        if self.since(alias) > tick or (moved_on and there == alias):
            return
        if alias in self.aliases:
            self.alias_of.pop(self.aliases[alias][0], None)
        if moved_on or (there is not None and self.since(there) > tick):
            self.aliases[alias] = (None, tick)
            return
        self.leave(index)
        self.aliases[alias], self.alias_of[index] = (index, tick), alias

    def since(self, alias):
        """The tick of the last assignment of an alias; the tick of the snapshot if there was none."""
        return self.aliases[alias][1] if alias in self.aliases else 0

    # 6.0 The subscriber's side of the procedure, line by line

    def receive_datagram(self, data):
        try:
            msg = packets.decoded(data)
        except packets.Malformed:
            return
        if msg["stream"] != self.stream or msg["kind"] == 6 or len(data) > self.largest_packet:
            return
        if msg["kind"] in packets.OVER_BUDGET and not self.capped:
            return
        if msg["kind"] == 9:
            return self.receive_repair_symbol(msg)
        msg["data"] = data
        if self.due(msg):
            self.read(msg)
        self.rebuild()
        self.settle()

    def due(self, msg):
        if self.has_snapshot and expanded(msg["events"], self.scene_events) <= self.scene_events:
            return True
        if len(self.pending) < PENDING_MAX:
            self.pending.append(msg)
        return False

    def release(self):
        """read_waiting"""
        waiting, self.pending = self.pending, []
        for msg in waiting:
            if self.due(msg):
                self.read(msg)
                self.rebuild()
        self.settle()

    def settle(self):
        if self.is_converged() and self.known_from <= self.watermark:
            self.converged_at = self.watermark

    def read(self, msg, rebuilt=False):
        if self.lost_sync:
            return
        tick = expanded(msg["tick"], self.newest)
        if tick > self.newest + JUMP:
            self.lost_sync = True
        elif msg["kind"] in (2, 7, 12):
            self.receive_watermark(msg, tick)
        elif msg["kind"] == 3:
            self.receive_refresh(msg, tick)
        else:
            self.receive_packet(msg, tick, rebuilt)

    def receive_packet(self, msg, tick, rebuilt):
        number = expanded(msg["number"], self.next)
        late = number < self.next
        if not late:
            self.announce(number + 1, tick)
            if self.lost_sync:
                return
            del self.missing[number]
        elif number in self.missing:
            self.fill(number, 0)
        else:
            return
        self.arrived |= set() if rebuilt else {number}
        self.newest = max(self.newest, tick)
        ends, before = msg["kind"] in (1, 5, 11), max(tick - 1, 0)
        self.watermark = max(self.watermark, tick if ends else before - before % self.config["publish interval"])
        self.statements.packet(number, tick, stated(msg) if ends else None)
        if msg["kind"] in (4, 5):
            for record in msg["records"]:
                self.put(record["index"], Track(tick, "uniform", record["motion"]), tick)
        else:
            if msg["kind"] != 11:
                self.decoder.keep(number, msg["data"])
            self.received[number] = (msg, tick)
            self.apply_all(msg["updates"], number, tick)
        if late:
            self.read_again(number)

    def announce(self, end, tick):
        if end - min(self.missing, default=self.next) > HISTORY:
            self.lost_sync = True
            return
        for number in range(self.next, end):
            self.missing[number] = (tick, None)
        self.next = max(self.next, end)

    def receive_watermark(self, msg, tick):
        number = expanded(msg["next"], self.next)
        self.announce(number, tick)
        if self.lost_sync:
            return
        self.newest, self.watermark = max(self.newest, tick), max(self.watermark, tick)
        if msg["kind"] == 7:
            self.compare(msg)
        else:
            self.statements.watermark(number, tick, stated(msg))

    def apply_all(self, updates, number, tick):
        """6.2-3"""
        for names_parent in (False, True):
            for update in updates:
                if names_parent == (update.get("mode") == "attached" or update.get("parent_age") is not None):
                    self.apply(update, number, tick)

    def apply(self, update, number, tick):
        index = update["body"]
        if index is not None:
            self.assign_alias(update["alias"], index, tick)
        else:
            index, since = self.aliases.get(update["alias"], (None, 0))
            if index is None or since > tick:
                return self.unreadable(number, tick, waits=False)
        body = self.bodies.get(index)
        if body is None:
            return None
        if tick <= body.track.origin:
            return self.overtaken(body, update, tick)
        track = self.new_track(body, update, tick)
        if track is UNREADABLE:
            self.unreadable(number, tick, waits=True)
        elif track is NO_SUCH_PARENT_TRACK:
            self.unreadable(number, tick, waits=False)
        elif track is not None:
            body.before, body.track = body.track, track
        return None

    def put(self, index, track, tick):
        body = self.bodies.get(index)
        if body is None:
            return
        if tick <= body.track.origin:
            self.overtaken_by(body, track, tick)
        else:
            body.before, body.track = body.track, track

    def overtaken(self, body, update, tick):
        self.overtaken_by(body, track_of_keyframe(tick, update["keyframe"]) if "keyframe" in update else None, tick)

    def overtaken_by(self, body, track, tick):
        if body.before is None or not body.before.origin < tick < body.track.origin:
            return
        body.before = track
        if track is None:
            self.known_from = max(self.known_from, body.track.origin)

    def unreadable(self, number, tick, waits):
        if number in self.missing:
            return
        if waits and any(other < number for other in self.missing):
            self.unread[number] = tick
        else:
            self.missing[number] = (tick, None)
            self.unread.pop(number, None)

    def fill(self, number, as_of):
        self.missing.pop(number, None)
        for other, tick in sorted(self.unread.items()):
            if other > number and tick > as_of:
                del self.unread[other]
                self.missing[other] = (tick, None)
        oldest = min(self.missing, default=self.next)
        self.unread = {other: tick for other, tick in self.unread.items() if other > oldest}

    def read_again(self, number):
        for other in range(number + 1, self.next):
            if other in self.missing and other in self.received and other in self.decoder.symbols:
                msg, tick = self.received[other]
                self.fill(other, 0)
                self.apply_all(msg["updates"], other, tick)

    def receive_refresh(self, msg, tick):
        lost = expanded(msg["lost"], self.next)
        if lost not in self.missing:
            return
        if any(record["age"] > tick for record in msg["records"]):
            return
        for record in msg["records"]:
            self.receive_record(record, tick)
        name = (tick, expanded(msg["events"], self.scene_events), msg["parts"])
        shown, refresh = self.missing[lost]
        if refresh is None or refresh[0] < name:
            refresh = (name, set())
            self.missing[lost] = (shown, refresh)
        if refresh[0] > name:
            return
        refresh[1].add(msg["part"])
        if len(refresh[1]) == msg["parts"]:
            self.fill(lost, tick)
            self.read_again(lost)

    def receive_record(self, record, tick):
        index, body = record["index"], self.bodies.get(record["index"])
        if record["alias"] is not None:
            self.assign_alias(record["alias"], index, tick)
        elif index in self.alias_of and self.since(self.alias_of[index]) <= tick:
            self.leave(index)
        if body is None:
            return
        if tick - record["age"] > body.track.origin:
            body.track = track_of_keyframe(tick - record["age"], record["keyframe"])
        body.before = None
        self.known_from = max(self.known_from, body.track.origin)

    # 6.15 Repair symbols

    def receive_repair_symbol(self, msg):
        if self.has_snapshot:
            last = expanded(msg["last"], self.next)
            self.decoder.receive(last, msg["covered"], msg["row"], bytes.fromhex(msg["symbol"]), self.next)
            self.rebuild()
            self.settle()

    def rebuild(self):
        while (found := self.decoder.rebuilt()) is not None:
            number, data = found
            try:
                msg = packets.decoded(data)
                packets.refuse_if(msg["kind"] > 1, "UnknownCode")
            except packets.Malformed:
                self.decoder.was_wrong()
                return
            self.decoder.keep(number, data)
            msg["data"] = data
            if self.due(msg):
                self.read(msg, rebuilt=True)

    # 6.2 Revisions

    def age(self, track, tick):
        """How old a track is (5.6), or None if it is of a later tick."""
        publish_interval = self.config["publish interval"]
        return tick // publish_interval - track.origin // publish_interval if track.origin <= tick else None

    def new_track(self, body, update, tick):
        """The track that an update gives; None if the update is ignored."""
        if "keyframe" in update:
            return track_of_keyframe(tick, update["keyframe"])
        old = body.track
        if self.age(old, tick) != update["age"]:
            return UNREADABLE
        own, predictor, parent, acceleration = self.own(body, old, tick), old.predictor, old.parent, old.acceleration
        if "negated" in update:
            return UNREADABLE if old.parent else self.apply_rest_update(own, update, tick) or UNREADABLE
        if update["mode"] == "world":
            parent_body = self.parent(old)
            predictor, parent, acceleration = PREDICTORS[update["predictor"]], None, acceleration_of(update)
            if (old.parent is None) != (update["parent_age"] is None):
                return UNREADABLE
            if old.parent is not None:
                if parent_body is None:
                    return UNREADABLE
                if self.age(parent_body.track, tick) != update["parent_age"]:
                    return NO_SUCH_PARENT_TRACK
                own = reckoning.attached_motion(self.own(parent_body, parent_body.track, tick), own)
        elif update["mode"] == "attached":
            by = self.bodies.get(update["parent"])
            if by is None:
                return None
            if self.age(by.track, tick) != update["parent_age"]:
                return NO_SUCH_PARENT_TRACK
            if by is body or by.track.parent is not None or old.parent is not None:
                return UNREADABLE
            own = reckoning.relative_to(self.own(by, by.track, tick), own)
            predictor, parent, acceleration = "rest", (by.index, by.generation), None
        triples = [tuple(update[name]) if name in update else None for name in packets.TRIPLES]
        over = reckoning.prediction_error(old.predictor, tick - old.origin, body.flow.dt)
        anchor = reckoning.Residual(*triples, update.get("velocity_exponent", 0)).onto(own, over, body.grid)
        if predictor == "rest":
            anchor = replace(anchor, linear=(0, 0, 0), angular=(0, 0, 0))
        return Track(tick, predictor, anchor, parent, acceleration)

    def apply_rest_update(self, own, update, tick):
        """RECKONING 4.7"""
        steps = update["steps"]
        numbers = reckoning.rest_state(own, update["negated"], steps[:3], steps[3:6], steps[6])
        return numbers and Track(tick, "rest", [struct.pack(">f", number).hex() for number in numbers])

    # 6.12 State checksum

    def sum(self):
        return sum(checksums(body) for body in self.bodies.values()) & MASK

    def compare(self, msg):
        """6.12-5, 6.12-6: a mismatch is a fault; only a new snapshot helps."""
        alike = expanded(msg["next"], self.next) == self.next
        if not (self.is_converged() and alike and expanded(msg["events"], self.scene_events) == self.scene_events):
            return
        if self.sum() != int(msg["checksum"], 16):
            self.checksum_mismatches += 1
            self.lost_sync = True

    # State of the copy

    def is_converged(self):
        return self.has_snapshot and not (self.missing or self.unread or self.pending or self.lost_sync)

    def complete(self):
        if self.is_converged() and self.known_from <= self.watermark:
            return self.watermark
        return self.converged_at

    def is_within(self, body, tick):
        """6.8-4, 6.16-11: whether a body is known to be within its tolerance, times the error scale, at a tick."""
        interval = self.config["publish interval"]
        if self.lost_sync or tick > self.watermark or (tick != self.start and tick % interval):
            return False
        if self.error_scale(tick) is None or not self.is_known(body, tick):
            return False
        track = self.track_at(body, tick)
        parent = self.parent(track)
        return track.parent is None or (parent is not None and self.is_known(parent, tick))

    def is_known(self, body, tick):
        """6.8-4, 6.8-5: whether the track of a body that holds at a tick is known."""
        doubtful = max([shown for shown, _ in self.missing.values()] + list(self.unread.values()), default=0)
        return doubtful <= self.track_at(body, tick).origin <= tick

    def error_scale(self, tick):
        """6.16: the factor by which errors may exceed the tolerance at a tick, in eighths; None if unknown."""
        return self.statements.at(tick) if self.capped else 8

    def resync(self):
        """6.7-10: the cause of the `Resync` that a copy needs, or None."""
        return int(self.checksum_mismatches > 0) if self.lost_sync else None

    def requests(self):
        """6.15-8 to 6.15-11: `repair_symbols` of a loss report that requests them, and the numbers that it names."""
        missing = sorted(self.missing)
        count = self.decoder.requested(missing, self.next)
        named = [number for number in missing if not (count and number in self.decoder.symbols)]
        return [count, [number & 0xFFFF for number in named[: LIMITS["LOST_NUMBERS_MAX"]]]]

    def loss_report(self):
        """5.13"""
        lost = [number & 0xFFFF for number in sorted(self.missing)[: LIMITS["LOST_NUMBERS_MAX"]]]
        head = {"stream": self.stream, "kind": 6, "next": self.next & 0xFFFF}
        # Repair symbols are not requested: refreshes suffice (6.15).
        return head | {"abandoned": (self.next - self.first - len(self.arrived)) & 0xFFFF, "repair_symbols": 0, "lost": lost}


# 6.16 Error scale

UNBOUNDED = float("inf")


def stated(msg):
    """The error scale of a packet or watermark, in eighths."""
    eighths = msg.get("error_scale_eighths", 8)
    return UNBOUNDED if eighths is None else eighths


class ErrorScaleLog:
    """The error scales stated by a stream with a budget; factors in eighths."""

    def __init__(self, number, snapshot):
        self.factors, self.next, self.since = [], number, snapshot

    def packet(self, number, tick, error_scale):
        """`error_scale`: the stated factor, if the packet ends its tick."""
        since = self.since if number == self.next else tick
        if error_scale is not None:
            self.factors.append((since, tick, error_scale))
        if number >= self.next:
            self.next, self.since = number + 1, tick + 1 if error_scale is not None else since

    def watermark(self, number, tick, error_scale):
        self.factors.append((self.since if number == self.next else tick, tick, error_scale))

    def at(self, tick):
        least = min((error_scale for first, last, error_scale in self.factors if first <= tick <= last), default=UNBOUNDED)
        return None if least == UNBOUNDED else least


def bits64(values):
    return b"".join(struct.pack("<d", value) for value in values)
