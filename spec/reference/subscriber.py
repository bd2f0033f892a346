"""A member's copy of a scene, from PROTOCOL 6: tracks, gaps, repairs, seats, gravity, notices.

Fed with messages and datagrams; asks for nothing by itself. For reading beside the document, not for speed.
"""

import struct
from dataclasses import dataclass, replace

import packets
import reckoning
from messages import LIMITS, f32, motion_of
from restorer import Restorer

LAWS = ("rest", "uniform", "ballistic", "tumbling", "thrown", "pushed")
HISTORY, JUMP, HELD = LIMITS["HISTORY_PACKETS"], LIMITS["TICK_JUMP_MAX"], LIMITS["PACKETS_HELD_MAX"]
SEATINGS = LIMITS["SEATINGS_KEPT"]
IDENTITY = ["00000000", "00000000", "00000000", "3f800000"]


class Violation(Exception):
    """The server contradicts what it said; the argument is the code to close with."""


# 6.1 Tracks


@dataclass
class Track:
    origin: int
    law: str
    anchor: object  # reckoning.Snapped, or a list of thirteen f32s as digits
    carrier: tuple = None  # index, generation
    push: reckoning.Push = None  # of the law that is pushed

    def is_verbatim_rest(self):
        return self.law == "rest" and isinstance(self.anchor, list)


def track_of_whole(origin, whole):
    """5.5"""
    law, carrier = LAWS[whole["law"]], whole["carrier"]
    if "verbatim" in whole:
        anchor = whole["verbatim"]
    else:
        rotation = (whole["largest"], tuple(whole["others"]))
        anchor = reckoning.Snapped(tuple(whole["position"]), rotation, tuple(whole["linear"]), tuple(whole["angular"]))
    return Track(origin, law, anchor, tuple(carrier) if carrier else None, push_of(whole))


def push_of(said):
    """That of a whole track or an update."""
    return reckoning.Push.of(said["push"]["steps"], said["push"]["doublings"]) if "push" in said else None


def track_of_notice(said):
    """4.6"""
    if said["said"]["is"] == "in bits":
        bits = packets.BitReader(bytes.fromhex(said["said"]["whole"]))
        return track_of_whole(said["origin"], packets.read_whole(bits))
    return Track(said["origin"], said["said"]["is"], motion_of(said["said"]["anchor"]))


class Body:
    """What a body is, and how it moves."""

    def __init__(self, terms, inertia, track, scene):
        self.index, self.generation = terms["id"]["index"], terms["id"]["generation"]
        dynamic = terms["flags"] & 3 == 1
        damping = terms.get("damping", scene.terms["damping"])
        still = {"linear": "00000000", "angular": "00000000"}
        self.flow = scene.flow(damping if dynamic else still)
        self.scale = f32(terms.get("gravity scale", "3f800000")) if dynamic else 0.0
        self.class_ = terms.get("class", 0)
        self.grid = scene.grid(radius_of(scene.shapes[terms["shape"]]), self.class_)
        self.inertia = None
        if inertia and inertia["is"] != "none":
            moments = [f32(part) for part in inertia["moments"]]
            self.inertia = reckoning.Inertia.of(moments, [f32(part) for part in inertia.get("frame", IDENTITY)])
        self.track, self.before, self.older = track, None, []

    def moved(self, track, tick, gravity):
        """The motion of one of its tracks at a tick, in the track's own frame (RECKONING 3.1)."""
        if isinstance(track.anchor, list):
            start = reckoning.verbatim_motion([f32(part) for part in track.anchor])
        else:
            start = track.anchor.motion(self.grid)
        elapsed = reckoning.elapsed_ticks(tick, track.origin)
        pull = reckoning.gravity_of(gravity, self.scale)
        return reckoning.predicted(track.law, start, elapsed, pull, self.flow, self.inertia, track.push)


def radius_of(shape):
    """RECKONING 4.5, and 2.6 for hulls"""
    if shape["is"] == "heights":
        along, across = f32(shape["row spacing"]), f32(shape["column spacing"])
        places = ((place // shape["columns"], place % shape["columns"]) for place in range(len(shape["heights"])))
        posts = zip(places, shape["heights"])
        return max(reckoning.length3([row * along, f32(y), column * across]) for (row, column), y in posts)
    if shape["is"] == "mesh":
        return max(reckoning.length3([f32(part) for part in point]) for point in shape["points"])
    if shape["is"] == "compound":
        balls = [reckoning.length3([f32(x) for x in part["position"]]) + radius_of(part["shape"]) for part in shape["parts"]]
        return max([f32("3a83126f"), *balls])
    if shape["is"] == "hull":
        return max(reckoning.length3([f32(part) for part in point]) for point in shape["points"])
    if shape["is"] == "cuboid":
        return reckoning.bounding_radius("cuboid", [f32(part) for part in shape["half extents"]])
    if shape["is"] == "ball":
        return reckoning.bounding_radius("ball", [f32(shape["radius"])])
    return reckoning.bounding_radius(shape["is"], [f32(shape["half height"]), f32(shape["radius"])])


# 5.7 Low 16 bits


def expanded(low, expected):
    count = expected - ((expected - low) & 0xFFFF)
    if count < 0 or expected - count >= 0x8000:
        count += 0x10000
    return count


# 6.12 Agreement

MASK = (1 << 64) - 1
F = 0x9E3779B97F4A7C15


def mix(h, w):
    p = (h ^ w) * F & MASK
    return p ^ (p >> 32)


def pair(a, b):
    return (a & 0xFFFFFFFF) | (b & 0xFFFFFFFF) << 32


def digest(body):
    track = body.track
    h = mix(F, pair(body.index, body.generation))
    h = mix(h, track.origin)
    if track.carrier:
        h = mix(h, pair(*track.carrier))
    law = LAWS.index(track.law)
    if isinstance(track.anchor, list):
        numbers = [int(part, 16) for part in track.anchor] + [0]
        words = [2 * law + 1] + [pair(a, b) for a, b in zip(numbers[::2], numbers[1::2])]
    else:
        x, y, z = track.anchor.position
        largest, (a, b, c) = track.anchor.rotation
        u, v, w = track.anchor.linear
        p, q, r = track.anchor.angular
        words = [2 * law, pair(x, y), pair(z, largest), pair(a, b), pair(c, u), pair(v, w), pair(p, q), pair(r, 0)]
    if track.push:
        x, y, z = track.push.steps
        words += [pair(x, y), pair(z, track.push.doublings)]
    for word in words:
        h = mix(h, word)
    return h


class Scene:
    """What a member knows of its scene, by one stream."""

    def __init__(self, joined):
        self.choice, self.terms, self.stream = joined["choice"], joined["terms"], joined["stream"]
        # The stream of a choice with a budget is that of the choice in it, but for what it states.
        self.capped = self.choice["is"] == "within a budget"
        self.choice = self.choice["choice"] if self.capped else self.choice
        self.statements = Statements(joined["next"], joined["tick"])
        self.flows, self.shapes, self.bodies, self.joints = {}, {}, {}, {}
        self.gravities = [(0, [f32(part) for part in joined["gravity"]])]
        self.snapshot_gravity = False
        self.whole, self.notices, self.next = False, joined["notices"], joined["next"]
        self.vouched = self.newest = self.settled_at = joined["tick"]
        self.known_from = 0
        self.seats, self.seat_of = {}, {}  # seat: (index, since); index: seat
        self.remembers = False
        self.repaired = 0  # the newest tick of a repair
        self.sat = []  # (since, seat, index or None), while something is missing or unread
        self.sat_last = {}  # of these the last of (since, seat)
        self.missing, self.unread, self.parts, self.held, self.gone = {}, {}, {}, [], 0
        self.unreadable = {}  # packets of which something was unread
        self.restorer = Restorer(self.stream)
        self.lost_touch, self.disagreements, self.granted = False, 0, joined["granted"]
        self.doubted, self.amended = None, []  # doubted indices: first, how many

    def flow(self, damping):
        terms = self.terms
        key = (damping["linear"], damping["angular"])
        if key not in self.flows:
            dampings = [f32(part) for part in key]
            self.flows[key] = reckoning.Flow(terms["ticks"], terms["seconds"], terms["substeps"], *dampings)
        return self.flows[key]

    def grid(self, radius, class_):
        choice = self.choice
        # A full stream says nothing on a grid.
        length = reckoning.of_class(choice.get("micrometres", 1000), class_, 1000, 10000000)
        turn = choice.get("microradians")
        return reckoning.Grid.of(length, radius, turn and reckoning.of_class(turn, class_, 100, 3141593))

    def gravity(self, origin):
        """6.9"""
        return [pull for since, pull in self.gravities if since <= origin][-1]

    # Belief

    def own(self, body, track, tick):
        return body.moved(track, tick, self.gravity(track.origin))

    def carrier(self, track):
        """The body that carries a track's, if it is there still."""
        body = self.bodies.get(track.carrier[0]) if track.carrier else None
        return body if body and body.generation == track.carrier[1] else None

    def believed(self, body, tick):
        """RECKONING 3.8"""

        def then(body):
            before = body.before
            if body.track.origin > tick and before and before.origin <= tick:
                return before
            return body.track

        track = then(body)
        motion, carrier = self.own(body, track, tick), self.carrier(track)
        if carrier is None:
            return motion
        return reckoning.carried(self.own(carrier, then(carrier), tick), motion)

    # 4.6, 4.8 Notices

    def hear_notice(self, said):
        name = said["is"]
        if name == "ShapeAdded":
            self.shapes[said["id"]] = said["shape"]
        elif name == "ShapeRemoved":
            self.must(said["id"] in self.shapes)
            del self.shapes[said["id"]]
        elif name == "BodyPlaced":
            self.place(said)
        elif name == "BodyRemoved":
            body = self.bodies.get(said["id"]["index"])
            self.must(body and body.generation == said["id"]["generation"])
            self.dismiss(body.index)
            del self.bodies[body.index]
            self.part(said["id"])
        elif name == "GravityChanged":
            pull = [f32(part) for part in said["gravity"]]
            if not self.whole and not self.snapshot_gravity:
                self.gravities, self.snapshot_gravity = [], True
            self.gravities = [old for old in self.gravities if old[0] < said["tick"]] + [(said["tick"], pull)]
        elif name == "JointAdded":
            self.must(said["id"] not in self.joints)
            for id_ in (said["joint"]["first"], said["joint"]["second"]):
                body = self.bodies.get(id_["index"])
                self.must(body and body.generation == id_["generation"])
            self.joints[said["id"]] = said["joint"]
        elif name == "JointRemoved":
            self.must(said["id"] in self.joints)
            del self.joints[said["id"]]
        if self.whole:
            self.notices += 1
            self.release()

    def must(self, good):
        if not good:
            raise Violation(2)

    def part(self, id_):
        """4.6-2: with a body its joints are gone too."""
        joints = self.joints.items()
        self.joints = {name: joint for name, joint in joints if id_ not in (joint["first"], joint["second"])}

    def place(self, said):
        self.must(said["terms"]["shape"] in self.shapes)
        body = Body(said["terms"], said.get("inertia"), track_of_notice(said["track"]), self)
        self.dismiss(body.index)
        before = self.bodies.get(body.index)
        if before:
            self.part({"index": before.index, "generation": before.generation})
        self.bodies[body.index] = body
        if said["seat"]:
            self.sit(said["seat"] - 1, body.index, self.newest)

    def end_snapshot(self):
        self.whole = True
        self.release()

    # 6.13 Seats

    def leave(self, index):
        seat = self.seat_of.pop(index, None)
        if seat is not None:
            self.seats[seat] = (None, self.seats[seat][1])

    def dismiss(self, index):
        """6.13-14."""
        self.leave(index)
        self.sat = [(since, seat, None if who == index else who) for since, seat, who in self.sat]
        self.sat_last = {(since, seat): who for since, seat, who in self.sat}

    def note(self, seat, index, since):
        """6.13-13, each once (6.13-15)."""
        self.remembers = self.remembers or bool(self.missing or self.unread)
        if self.remembers and self.sat_last.get((since, seat), "nothing") != index:
            self.sat.append((since, seat, index))
            self.sat_last[since, seat] = index

    def note_sitter(self, seat):
        index, since = self.seats.get(seat, (None, 0))
        if index is not None:
            self.note(seat, index, since)

    def sitter_at(self, seat, number, tick):
        """Who sits in a seat at a tick, or sat there; None if nobody is known."""
        index, since = self.seats.get(seat, (None, 0))
        if index is not None and since <= tick:
            return index
        if tick < self.repaired or len(self.sat) > SEATINGS or any(other < number for other in self.missing):
            return None
        by_then = [change for change in self.sat if change[0] <= tick]
        here = [change for change in reversed(by_then) if change[1] == seat]
        if not here:
            return None
        since, _, index = max(here, key=lambda change: change[0])
        went = any(who == index and begun > since for begun, _, who in by_then)
        return None if went else index

    def sit(self, seat, index, tick):
        """6.13-7. A seat of which it is known that nobody is known to sit there has None for its body."""
        body, there = self.bodies.get(index), self.seat_of.get(index)
        gone_on = body is None or body.track.origin > tick
        self.note(seat, index, tick)
        if self.since(seat) > tick or (gone_on and there == seat):
            return
        self.note_sitter(seat)
        if seat in self.seats:
            self.seat_of.pop(self.seats[seat][0], None)
        if gone_on or (there is not None and self.since(there) > tick):
            self.seats[seat] = (None, tick)
            return
        if there is not None:
            self.note_sitter(there)
        self.leave(index)
        self.seats[seat], self.seat_of[index] = (index, tick), seat

    def since(self, seat):
        """The tick at which a seat was taken last; that of a beginning if it never was."""
        return self.seats[seat][1] if seat in self.seats else 0

    # 6.5 Reading

    def hear_datagram(self, data):
        try:
            said = packets.decoded(data)
        except packets.Malformed:
            return
        if said["stream"] != self.stream or said["kind"] in (6, 8):
            return
        if said["kind"] in packets.IN_ARREARS and not self.capped:
            return
        if said["kind"] == 9:
            self.hear_parity(said)
            return
        said["data"] = data
        if not self.whole or expanded(said["notices"], self.notices) > self.notices:
            if len(self.held) < HELD:
                self.held.append(said)
            return
        self.read(said)
        self.rebuild()
        self.settle()

    def release(self):
        waiting, self.held = self.held, []
        for said in waiting:
            if self.whole and expanded(said["notices"], self.notices) <= self.notices:
                self.read(said)
            else:
                self.held.append(said)
        self.rebuild()
        self.settle()

    def settle(self):
        self.remembers = bool(self.missing or self.unread)
        if not self.remembers:
            self.sat, self.sat_last = [], {}
        if self.is_settled() and self.known_from <= self.vouched:
            self.settled_at = self.vouched

    def read(self, said):
        if self.lost_touch:
            return
        tick = expanded(said["tick"], self.newest)
        if tick > self.newest + JUMP:
            self.lost_touch = True
            return
        kind = said["kind"]
        if kind in (2, 7, 12):
            number = expanded(said["next"], self.next)
            self.hear_vouch(number, tick)
            if kind != 7:
                self.statements.vouch(number, tick, stated(said))
            else:
                self.compare(said)
        elif kind == 3:
            self.hear_repair(said, tick)
        else:
            self.hear_packet(said, tick)

    # 6.6 Gaps

    def miss(self, end, tick):
        for number in range(self.next, min(end, self.next + HISTORY + 1)):
            self.missing[number] = tick
        self.gone += max(end - self.next, 0)
        self.next = max(self.next, end)
        if self.missing and self.next > min(self.missing) + HISTORY:
            self.lost_touch = True

    def hear_vouch(self, next_number, tick):
        self.miss(next_number, tick)
        self.newest, self.vouched = max(self.newest, tick), max(self.vouched, tick)

    def hear_packet(self, said, tick, rebuilt=False):
        number = expanded(said["number"], self.next)
        if number < self.next and number not in self.missing:
            return
        late = number < self.next
        if not late:
            self.miss(number, tick)
            self.next = max(self.next, number + 1)
        if self.lost_touch:
            return
        self.newest = max(self.newest, tick)
        if late:
            del self.missing[number]
            self.parts.pop(number, None)
            self.gone -= not rebuilt
        every = self.terms["every"]
        ends = said["kind"] in (1, 5, 11)
        self.statements.packet(number, tick, stated(said) if ends else None)
        before = max(tick - 1, 0)
        self.vouched = max(self.vouched, tick if ends else before - before % every)
        if said["kind"] in (4, 5):
            self.hear_full(said, tick)
        else:
            if said["kind"] != 11:
                # Packets in arrears have no column (5.17): none is read again.
                self.restorer.keep(number, said["data"])
            self.hear_state(said, number, tick)
        if late:
            self.made_good(number, None)
            self.read_again_after(number)

    def made_good(self, number, repaired_at):
        """A missing packet was heard late (None), or repaired by a repair of a tick."""
        for other, tick in sorted(self.unread.items()):
            if other > number and (repaired_at is None or repaired_at < tick):
                del self.unread[other]
                self.missing[other] = tick
        if self.missing:
            oldest = min(self.missing)
            self.unread = {other: tick for other, tick in self.unread.items() if other > oldest}
        else:
            self.unread = {}

    def read_again_after(self, number):
        """What could not be read, and whose bytes are there still, in order, each as one that comes late."""
        for other in range(number + 1, self.next):
            if other in self.missing and other in self.unreadable and other in self.restorer.columns:
                tick = self.missing.pop(other)
                self.parts.pop(other, None)
                self.made_good(other, None)
                self.hear_state(self.unreadable.pop(other), other, tick)

    # 6.15 Redundancy

    def hear_parity(self, said):
        if self.whole:
            last = expanded(said["last"], self.next)
            self.restorer.hear(last, said["covered"], said["row"], bytes.fromhex(said["sums"]), self.next)
            self.rebuild()
            self.settle()

    def rebuild(self):
        while (found := self.restorer.rebuilt()) is not None:
            number, data = found
            try:
                said = packets.decoded(data)
            except packets.Malformed:
                self.restorer.was_wrong(self.next)
                return
            self.restorer.keep(number, data)
            said["data"] = data
            if expanded(said["notices"], self.notices) > self.notices:
                self.held.append(said)
            else:
                self.hear_packet(said, expanded(said["tick"], self.newest), rebuilt=True)

    # 6.2 Revisions

    def hear_state(self, said, number, tick):
        later, outcomes = [], []
        for update in said["updates"]:
            if update.get("course") == "held" or update.get("carrier_age") is not None:
                later.append(update)
            else:
                outcomes.append(self.hear_update(update, number, tick))
        outcomes += [self.hear_update(update, number, tick) for update in later]
        for index in [index for index, body in self.bodies.items() if index in self.seat_of]:
            track = self.bodies[index].track
            if track.is_verbatim_rest() and track.origin == tick:
                self.note_sitter(self.seat_of[index])
                self.note(self.seat_of[index], None, tick + 1)
                self.leave(index)
        waits = "unread" in outcomes and any(other < number for other in self.missing)
        if "seatless" in outcomes or "unread" in outcomes and not waits:
            self.missing[number] = tick
        elif waits:
            self.unread[number] = tick
        if "seatless" in outcomes or "unread" in outcomes:
            self.unreadable[number] = said

    def hear_update(self, update, number, tick):
        """"heard", "unread", or "seatless"."""
        index = update["body"]
        if index is None:
            index = self.sitter_at(update["seat"], number, tick)
            if index is None:
                return "seatless"
        body = self.bodies.get(index)
        if update["body"] is not None:
            self.sit(update["seat"], index, tick)
        if body is None:
            return "heard"
        if "carrier" in update and update["carrier"] not in self.bodies:
            return "heard"
        old = body.track
        if tick <= old.origin:
            self.known_from = max(self.known_from, old.origin)
            return "heard"
        if "whole" in update:
            track = track_of_whole(tick, update["whole"])
        else:
            track = self.corrected(body, update, tick)
            if track is None:
                return "unread"
        if self.missing:
            body.older.append(body.before)
        elif body.older:
            body.older = []
        body.before, body.track = old, track
        return "heard"

    def age(self, track, tick):
        """How old a track is (5.6), or None if it is of a later tick."""
        every = self.terms["every"]
        return tick // every - track.origin // every if track.origin <= tick else None

    def revision(self, body, tick, age):
        """The body's track of an age, if it is still known (6.2, 6.6)."""
        known = (body.track, body.before, *body.older)
        tracks = [track for track in known if track and self.age(track, tick) == age]
        return tracks[0] if tracks else None

    def corrected(self, body, update, tick):
        """The track that a correction gives, or None where it cannot be read."""
        old = body.track
        if self.age(old, tick) != update["age"]:
            return None
        own, law, carrier, push = self.own(body, old, tick), old.law, old.carrier, old.push
        if "negated" in update:
            return None if old.carrier else self.settled(own, update, tick)
        if update["course"] == "world":
            held_by = self.carrier(old)
            law, carrier, push = LAWS[update["law"]], None, push_of(update)
            if (old.carrier is None) != (update["carrier_age"] is None):
                return None
            if old.carrier is not None:
                named = held_by and self.revision(held_by, tick, update["carrier_age"])
                if named is None:
                    return None
                own = reckoning.carried(self.own(held_by, named, tick), own)
        elif update["course"] == "held":
            by = self.bodies[update["carrier"]]
            named = self.revision(by, tick, update["carrier_age"])
            if by is body or named is None or named.carrier is not None or old.carrier is not None:
                return None
            own = reckoning.seen_from(self.own(by, named, tick), own)
            law, carrier, push = "rest", (by.index, by.generation), None
        said = [tuple(update[name]) if name in update else None for name in packets.TRIPLES]
        over = reckoning.astray(old.law, tick - old.origin, body.flow.dt)
        anchor = reckoning.Residual(*said, update.get("coarseness", 0)).onto(own, over, body.grid)
        if law == "rest":
            anchor = replace(anchor, linear=(0, 0, 0), angular=(0, 0, 0))
        return Track(tick, law, anchor, carrier, push)

    def settled(self, own, update, tick):
        """RECKONING 4.7"""
        steps = update["steps"]
        numbers = reckoning.settled(own, update["negated"], steps[:3], steps[3:6], steps[6])
        return numbers and Track(tick, "rest", [struct.pack(">f", number).hex() for number in numbers])

    # 6.10 The full stream

    def hear_full(self, said, tick):
        for record in said["records"]:
            body = self.bodies.get(record["index"])
            if body is None:
                continue
            if tick <= body.track.origin:
                self.known_from = max(self.known_from, body.track.origin)
                continue
            body.before, body.track = body.track, Track(tick, "uniform", record["motion"])

    # 6.7 Repair

    def hear_repair(self, said, tick):
        lost = expanded(said["lost"], self.next)
        self.newest = max(self.newest, tick)
        if lost >= self.next:
            self.hear_amends(said, tick)
            return
        if lost not in self.missing or self.may_amend(said):
            return
        self.repaired = max(self.repaired, tick)
        for record in said["records"]:
            self.hear_record(record, tick)
        name = (tick, said["notices"], said["parts"])
        heard = self.parts.get(lost, (name, set()))
        parts = heard[1] if heard[0] == name else set()
        parts.add(said["part"])
        self.parts[lost] = (name, parts)
        if len(parts) == said["parts"]:
            del self.missing[lost], self.parts[lost]
            self.made_good(lost, tick)
            self.read_again_after(lost)

    def hear_record(self, record, tick):
        index, body = record["index"], self.bodies.get(record["index"])
        if record["seat"] is not None:
            self.sit(record["seat"], index, tick)
        elif index in self.seat_of and self.seats[self.seat_of[index]][1] <= tick:
            self.note_sitter(self.seat_of[index])
            self.note(self.seat_of[index], None, tick)
            self.leave(index)
        track = track_of_whole(tick - record["age"], record["whole"])
        if body is not None and track.origin > body.track.origin:
            body.track, body.before = track, None
            self.known_from = max(self.known_from, track.origin)

    # 6.12 Agreement

    def may_amend(self, said):
        """6.12-8: whether it may be what answers a doubt, and came too late."""
        index, stride = self.doubted or (None, 0)
        alone = all(record["index"] == index and record["seat"] is None for record in said["records"])
        return stride == 1 and said["parts"] == 1 and alone

    def hear_amends(self, said, tick):
        """6.12-8: the track of a body that is doubted, in place of its own; of a packet that was not sent."""
        for record in said["records"]:
            index, body = record["index"], self.bodies.get(record["index"])
            if body is None or self.doubted != (index, 1):
                continue
            self.dismiss(index)
            body.track, body.before, body.older = track_of_whole(tick - record["age"], record["whole"]), None, []
            self.known_from = max(self.known_from, body.track.origin)
            self.doubted = None
            self.amended.append((index, body.generation))

    def doubt(self):
        """5.15: what to say while something is doubted."""
        first, stride = self.doubted
        return {"stream": self.stream, "kind": 8, "first": first, "stride": stride}

    def sum(self, first=0, end=1 << 20):
        return sum(digest(body) for body in self.bodies.values() if first <= body.index < end) & MASK

    def compare(self, said):
        alike = expanded(said["next"], self.next) == self.next
        if not (self.is_settled() and alike and expanded(said["notices"], self.notices) == self.notices):
            return
        for place, expected in enumerate(said["sums"]):
            first = said["first"] + place * said["stride"]
            if first >= 1 << 20:
                break
            if self.sum(first, first + said["stride"]) != int(expected, 16):
                self.disagreements += 1
                self.doubted = (first, said["stride"])
                return
        end = said["first"] + len(said["sums"]) * said["stride"]
        if self.doubted and said["first"] <= self.doubted[0] and sum(self.doubted) <= end:
            self.doubted = None

    # What is known

    def is_settled(self):
        return self.whole and not (self.missing or self.unread or self.held or self.lost_touch)

    def complete(self):
        if self.is_settled() and self.known_from <= self.vouched:
            return self.vouched
        return self.settled_at

    def excess(self, tick):
        """6.16: by what factor bodies may be off at a tick, in eighths; None where that is not known."""
        return self.statements.at(tick) if self.capped else 8

    def echo(self):
        """5.13"""
        lost = [number & 0xFFFF for number in sorted(self.missing)[: LIMITS["LOST_NAMED_MAX"]]]
        head = {"stream": self.stream, "kind": 6, "next": self.next & 0xFFFF}
        # No parities are asked for: repairs do (6.15).
        return head | {"gone": self.gone & 0xFFFF, "parities": 0, "lost": lost}


# 6.16 Statements

UNBOUNDED = float("inf")


def stated(said):
    """The excess that a packet or a vouch states, in eighths."""
    eighths = said.get("excess_eighths", 8)
    return UNBOUNDED if eighths is None else eighths


class Statements:
    """What a stream with a budget said of how far off its bodies are; factors in eighths."""

    def __init__(self, number, snapshot):
        self.said, self.next, self.since = [], number, snapshot

    def packet(self, number, tick, excess):
        """`excess`: what it states, if it ends its tick."""
        since = self.since if number == self.next else tick
        if excess is not None:
            self.said.append((since, tick, excess))
        if number >= self.next:
            self.next, self.since = number + 1, tick + 1 if excess is not None else since

    def vouch(self, number, tick, excess):
        self.said.append((self.since if number == self.next else tick, tick, excess))

    def at(self, tick):
        least = min((excess for first, last, excess in self.said if first <= tick <= last), default=UNBOUNDED)
        return None if least == UNBOUNDED else least


def bits64(values):
    return b"".join(struct.pack("<d", value) for value in values)
