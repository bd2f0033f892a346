"""A publisher that follows a script, and a member that receives what the script delivers.

It chooses nothing: the script says which bodies are updated, how, and what is lost. So the golden streams made with it
(make_streams.py) do not depend on how a publisher chooses. It predicts from a copy that loses nothing.
"""

import struct

import check_streams
import messages
import packets
import reckoning
import subscriber
import upstream

BODY_STATE_AT_REST = 7
GRAVITY = [0.0, -9.81, 0.0]
STILL = [0.0, 0.0, 0.0]
SURFACE = {"is": "within a surface tolerance", "micrometres": 5000}
# Half of them rotate in a way that depends on their inertia.
SHAPES = [{"is": "ball", "radius": 0.5}, {"is": "cuboid", "half extents": [0.5, 0.25, 0.375]}]
MOMENTS = [[2.0, 2.0, 2.0], [1.0, 2.0, 1.5]]


def digits(value):
    """A number or a list of numbers as digits of f32s."""
    return [digits(one) for one in value] if isinstance(value, list) else struct.pack(">f", value).hex()


class Dice:
    """A generator whose numbers are the same in every version of Python: splitmix64."""

    def __init__(self, seed):
        self.state = seed

    def below(self, end):
        self.state = (self.state + 0x9E3779B97F4A7C15) & subscriber.MASK
        z = self.state
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & subscriber.MASK
        z = (z ^ z >> 27) * 0x94D049BB133111EB & subscriber.MASK
        return (z ^ z >> 31) % end

    def steps(self, most):
        return [self.below(2 * most + 1) - most for _ in range(3)]


def config(**other):
    """A scene's config; words with "_" for blanks replace its fields."""
    material = {"friction": digits(0.5), "restitution": digits(0.0), "density": digits(500.0)}
    base = {"ticks": 60, "seconds": 1, "substeps": 4, "gravity": digits(GRAVITY), "stepping": 1, "material": material}
    base |= {"damping": {"linear": digits(0.125), "angular": digits(0.25)}, "sleep": {"is": "settled"}, "publish interval": 1, "lookahead": 0}
    return base | {name.replace("_", " "): value for name, value in other.items()}


def placed(index, generation=0, *, kind=1, shape=0, at=None, alias=0, origin=0, track="uniform", linear=STILL, **desc):
    """`BodyPlaced`. `alias` is one more than the alias; `track` is the name of a predictor."""
    position = [float(3 * index), 8.0, 0.0] if at is None else at
    anchor = {"present": 2 if any(linear) else 0, "position": digits(position)} | ({"linear": digits(linear)} if any(linear) else {})
    if track == "rest":
        anchor = {"present": 0, "position": digits(position)}
    desc = {"id": {"index": index, "generation": generation}, "flags": kind, "shape": shape} | desc
    order = ("id", "flags", "shape", "material", "damping", "gravity scale", "tolerance scale")
    for name, flag in (("damping", 8), ("gravity scale", 16), ("tolerance scale", 64)):
        desc["flags"] |= flag if name in desc else 0
    event = {"is": "BodyPlaced", "desc": {name: desc[name] for name in order if name in desc}}
    if kind == 1:
        event["inertia"] = {"is": "about own axes", "moments": digits(MOMENTS[shape])} if shape else {"is": "none"}
    return event | {"track": {"origin": origin, "payload": {"is": track, "anchor": anchor}}, "alias": alias}


class Stream:
    """A stream of a scene as a script makes it: the publisher, and all that one member received and then had."""

    def __init__(self, name, events, *, choice=SURFACE, gravity=None, tick=0, next=0, count=0, stream=5, largest_packet=1100, seed=1, **terms):
        self.name, self.recorded, self.dice = name, [], Dice(seed)
        self.config = config(**terms)
        joined = {"is": "Joined", "choice": choice, "config": self.config, "stream": stream, "gravity": digits(gravity or GRAVITY)}
        joined |= {"tick": tick, "next": next, "events": count, "largest packet": largest_packet, "extensions": []}
        self.joined = joined | {"granted": {"first": 0, "count": 4096, "generation": 0}}
        self.stream, self.count, self.number = stream, count, next
        shapes = [{"is": "ShapeAdded", "id": id_, "shape": {"is": shape["is"]} | {k: digits(v) for k, v in shape.items() if k != "is"}} for id_, shape in enumerate(SHAPES)]
        self.snapshot = [{"is": "SceneEvent", "event": event} for event in [*shapes, *events]]
        self.copy = check_streams.Member()
        for msg in [self.joined, *self.snapshot, {"is": "SnapshotEnd"}]:
            self.copy.receive(msg)
        self.tracks = self.copy.scene
        self.alias = dict(self.tracks.alias_of)
        self.history, self.sent = {}, {}
        self.requests = self.joints = False  # whether states say what a loss report requests, and which joints there are
        self.member = check_streams.Member()
        self.control({"is": "Welcome", "version": 1, "exists": 1, "config": self.config, "extensions": []}, quiet=True)

    # Data that the member receives

    def control(self, msg, quiet=False):
        data = messages.encoded("server", msg)
        self.recorded.append(["control", data.hex()])
        self.member.receive_control(data)
        if not quiet:
            self.know()

    def join(self, upto=None):
        """The snapshot; `upto` leaves the last of its messages for later."""
        self.later = [*self.snapshot, {"is": "SnapshotEnd"}]
        for msg in [self.joined, *self.later[:upto]]:
            self.control(msg, quiet=True)
        self.later = self.later[len(self.later) if upto is None else upto :]
        self.know()

    def end_snapshot(self):
        for msg in self.later:
            self.control(msg, quiet=len(self.later) > 1 and msg is not self.later[-1])

    def get(self, *datagrams, quiet=False):
        """The member receives these datagrams."""
        for data in datagrams:
            self.recorded.append(["datagram", data.hex()])
            if self.member.scene:
                self.member.scene.receive_datagram(data)
            if not quiet:
                self.know()
        return datagrams[0] if len(datagrams) == 1 else datagrams

    def know(self):
        """Before `SnapshotEnd` an application sees no copy."""
        if self.member.scene and self.member.scene.has_snapshot:
            asked = {"bodies"} | ({"requests"} if self.requests else set()) | ({"joints"} if self.joints else set())
            self.recorded.append(["known", check_streams.reported(self.member.scene, asked)])

    # Updates

    def names(self, index, alias=None):
        """The alias of a body, and its index if the update assigns it."""
        if alias is not None or index not in self.alias:
            alias = next(free for free in range(packets.INDICES) if free not in self.alias.values()) if alias is None else alias
            self.alias = {body: other for body, other in self.alias.items() if other != alias}
            self.alias[index] = alias
            return {"alias": alias, "body": index}
        return {"alias": self.alias[index], "body": None}

    def age(self, index, tick):
        return self.tracks.age(self.tracks.bodies[index].track, tick)

    def corrected(self, index, tick, mode="same", predictor=1, *, moved=False, size=40, alias=None, parent=None, parent_age=None, age=None, **other):
        """An update with a correction of random steps."""
        track = self.tracks.bodies[index].track
        update = self.names(index, alias) | {"mode": mode, "age": self.age(index, tick) if age is None else age}
        if mode == "world":
            update["predictor"] = predictor
            if track.parent:
                parent_age = self.age(track.parent[0], tick) if parent_age is None else parent_age
            update["parent_age"] = parent_age
            if predictor == packets.CONSTANT_ACCELERATION:
                update["acceleration"] = {"exponent": 2, "steps": self.dice.steps(200)}
        elif mode == "attached":
            update |= {"parent": parent, "parent_age": self.age(parent, tick) if parent_age is None else parent_age}
        if moved:
            update["velocity_exponent"] = self.dice.below(3)
        for triple in packets.TRIPLES[: 4 if moved else 2]:
            update[triple] = self.dice.steps(size)
        return update | other

    def keyframe(self, index, predictor=1, *, state=False, alias=None, parent=None, at=None, linear=STILL, angular=STILL):
        """An update with a keyframe."""
        body = self.tracks.bodies[index]
        at = [self.dice.below(40) / 8 - 2 for _ in range(3)] if at is None else at
        frame = {"predictor": predictor, "parent": parent}
        if predictor == packets.CONSTANT_ACCELERATION:
            frame["acceleration"] = {"exponent": 1, "steps": self.dice.steps(200)}
        if state:
            moving = [*linear, *angular] if predictor else [0.0] * 6
            frame["body_state"] = digits([*at, 0.0, 0.0, 0.0, 1.0, *moving])
        else:
            start = reckoning.Motion(tuple(at), (0.0, 0.0, 0.0, 1.0), tuple(linear), tuple(angular))
            frame |= quantised(reckoning.Quantised.of(start, body.grid), predictor)
        names = {"alias": None, "body": index} | self.names(index, self.alias.get(index) if alias is None else alias)
        return names | {"body": index, "keyframe": frame}

    def rests(self, index, tick, alias=None):
        """A rest correction: afterwards the publisher has taken the alias back."""
        update = self.names(index, alias) | {"age": self.age(index, tick), "negated": 0, "steps": [*self.dice.steps(50), *self.dice.steps(20), 3]}
        return update

    # Datagrams

    def head(self, kind, tick, count=None):
        return {"stream": self.stream, "kind": kind, "tick": tick & 0xFFFF, "events": (self.count if count is None else count) & 0xFFFF}

    def packet(self, tick, *updates, kind=1, scale=None, checked=True, count=None, number=None):
        """The next packet of the stream, not yet delivered."""
        number = self.number if number is None else number
        msg = self.head(kind, tick, count) | {"number": number & 0xFFFF, "updates": sorted(updates, key=lambda update: update["alias"])}
        if kind == 11:
            msg["error_scale_eighths"] = scale
        assert all(update.get("age", 1) > 0 for update in updates), f"{self.name}: an age of 0"
        data = packets.encoded(msg)
        assert packets.decoded(data) == msg, f"{self.name}: a packet that is not valid"
        self.history[number] = [update["body"] if update["body"] is not None else self.of(update["alias"]) for update in updates]
        self.numbered(number, data, checked)
        for update in updates:
            if "negated" in update or update.get("keyframe", {}).get("predictor") == 0 and "body_state" in update["keyframe"]:
                self.alias.pop(self.history[number][updates.index(update)], None)
        return data

    def full(self, tick, *indices, kind=5, number=None):
        """A packet of a full stream."""
        records = []
        for index in indices:
            motion = [self.dice.below(64) / 8 for _ in range(3)] + [0.0, 0.0, 0.0, 1.0] + [self.dice.below(64) / 8 for _ in range(6)]
            records.append({"index": index, "motion": digits(motion)})
        data = packets.encoded(self.head(kind, tick) | {"number": self.number & 0xFFFF, "records": records})
        self.history[self.number] = list(indices)
        self.numbered(self.number, data, True)
        return data

    def numbered(self, number, data, checked):
        """The publisher's own copy reads a packet; it reads an empty one in place of an unreadable one."""
        self.sent[number], self.number = data, max(self.number, number + 1)
        msg = packets.decoded(data)
        if not checked:
            msg |= {"kind": 1, "updates": [], "events": self.count & 0xFFFF}
        self.tracks.next = max(self.tracks.next, number)
        self.tracks.receive_datagram(packets.encoded(msg))
        assert self.tracks.is_converged() or self.tracks.lost_sync, f"{self.name}: packet {number} cannot be read"

    def of(self, alias):
        return next((index for index, other in self.alias.items() if other == alias), None)

    def watermark(self, tick, kind=2, scale=None, count=None, next=None):
        extra = {"error_scale_eighths": scale} if kind == 12 else {}
        return packets.encoded(self.head(kind, tick, count) | {"next": (self.number if next is None else next) & 0xFFFF} | extra)

    def checksum(self, tick, off=0, count=None, next=None):
        total = (self.tracks.sum() + off) & subscriber.MASK
        fields = {"next": (self.number if next is None else next) & 0xFFFF, "checksum": f"{total:016x}"}
        return packets.encoded(self.head(7, tick, count) | fields)

    def refresh(self, lost, tick, parts=1, bodies=None, without_alias=(), count=None):
        """The parts of a refresh: present tracks of the bodies of a packet."""
        indices = sorted(set(self.history.get(lost, []) if bodies is None else bodies) & set(self.tracks.bodies))
        records = [self.record(index, tick, index in without_alias) for index in indices]
        share = -(-max(len(records), 1) // parts)
        head = self.head(3, tick, count) | {"lost": lost & 0xFFFF, "parts": parts}
        return [packets.encoded(head | {"part": part, "records": records[part * share : (part + 1) * share]}) for part in range(parts)]

    def record(self, index, tick, without_alias=False):
        track = self.tracks.bodies[index].track
        alias = None if without_alias else self.alias.get(index)
        assert tick >= track.origin, f"{self.name}: a refresh older than its track"
        return {"index": index, "alias": alias, "age": tick - track.origin, "keyframe": keyframe_of(track)}

    def repair(self, row, *numbers):
        """The repair symbol of some packets."""
        return packets.repair_symbol(row, [(number, self.sent[number]) for number in sorted(numbers)])

    def settle(self, tick):
        """Refreshes everything that the member misses; afterwards it must have the publisher's tracks."""
        self.get(self.watermark(tick))
        for _ in range(99):
            if self.member.scene.missing:
                self.get(*self.refresh(min(self.member.scene.missing), tick))
        self.get(self.checksum(tick))
        scene = self.member.scene
        assert scene.is_converged() and scene.sum() == self.tracks.sum(), self.name

    # Scene events

    def event(self, event):
        """A scene event happens; the member does not have it yet."""
        self.tracks.receive_scene_event(event)
        self.count += 1
        index = event["desc"]["id"]["index"] if event["is"] == "BodyPlaced" else event["id"]["index"] if event["is"] == "BodyRemoved" else None
        self.alias.pop(index, None)
        return {"is": "SceneEvent", "event": event}


class Authority(Stream):
    """An upstream as a script makes it: the member with authority, and what the server received and then had."""

    def __init__(self, name, events, tick, lockstep=False):
        super().__init__(name, events, gravity=STILL, tick=tick, largest_packet=messages.LIMITS["DATAGRAM_BYTES_MAX"])
        descs = [event["desc"] for event in events]
        granted = [{"id": event["desc"]["id"], "motion": event["track"]["payload"]["anchor"]} for event in events]
        self.grant = {"is": "AuthorityGrant", "stream": self.stream, "tick": tick, "bodies": granted}
        self.member.scene = upstream.Upstream(self.grant, self.config, SURFACE, self.tracks.shapes, descs, self.joined["largest packet"])
        self.recorded = [["grant", messages.encoded("server", self.grant).hex(), *(["lockstep"] if lockstep else [])]]
        self.lockstep = lockstep

    def get(self, *datagrams):
        """The server receives these datagrams."""
        for data in datagrams:
            self.recorded.append(["datagram", data.hex()])
            if not self.lockstep:
                self.member.scene.receive_datagram(data)

    def take(self, *packets):
        """The server receives these packets in `Upstream` messages."""
        sent = b"".join(messages.encoded("client", {"is": "Upstream", "packet": data.hex()}) for data in packets)
        self.recorded.append(["control", sent.hex()])
        for data in packets if self.lockstep else ():
            self.member.scene.receive_datagram(data)

    def know(self):
        """The server's state shows when it steps."""

    def step(self, *ticks):
        for tick in ticks:
            self.recorded.append(["step", tick, check_streams.upstream_known(self.member.scene, tick)])


def removed(index, generation=0):
    return {"is": "BodyRemoved", "id": {"index": index, "generation": generation}, "cause": 0}


def gravity_changed(tick, *gravity):
    return {"is": "GravityChanged", "tick": tick, "gravity": digits(list(gravity))}


def quantised(anchor, predictor):
    """The fields of a keyframe in steps."""
    largest, others = anchor.rotation
    still = [0, 0, 0]
    moving = {"linear": list(anchor.linear) if predictor else still, "angular": list(anchor.angular) if predictor else still}
    return {"position": list(anchor.position), "largest": largest, "others": list(others)} | moving


def keyframe_of(track):
    """A track as the keyframe of a refresh."""
    predictor = subscriber.PREDICTORS.index(track.predictor)
    frame = {"predictor": predictor, "parent": list(track.parent) if track.parent else None}
    if track.acceleration:
        frame["acceleration"] = {"exponent": track.acceleration.exponent, "steps": list(track.acceleration.steps)}
    if isinstance(track.anchor, list):
        return frame | {"body_state": list(track.anchor)}
    return frame | quantised(track.anchor, predictor)
