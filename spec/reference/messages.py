"""The control stream (PROTOCOL 2 to 4): frames, and messages by the table of spec/tables/protocol.json.

A message is {"is": its name, ...fields by name}; f32s are the eight hexadecimal digits of their bits, bytes are
hexadecimal digits. Rules that the table cannot express are functions below, named by their clauses.
"""

import json
import math
import struct
from pathlib import Path

import reckoning
from packets import BitReader, Bytes, Malformed, read_keyframe, refuse_if, varint

TABLE = json.loads((Path(__file__).resolve().parent.parent / "tables" / "protocol.json").read_text(encoding="utf-8"))
TYPES, LIMITS = TABLE["types"], TABLE["limits"]
COUNT_MAX, WORD = 1 << 48, 1 << 32
OPTIONAL = 0x80
IDENTITY = ["00000000", "00000000", "00000000", "3f800000"]
STILL = ["00000000"] * 3
SLACK = 0.001


class UnknownCommand(Exception):
    """An unknown command: it is refused, and is counted (3.5-5)."""


def not_finite(quantity):
    """The error of 2.6-29."""
    return {"is": "NotFinite", "quantity": TABLE["quantities"].index(quantity)}


class Refused(Exception):
    """A well-formed command or configuration with a number outside the limits (4.5)."""

    def __init__(self, name, quantity):
        super().__init__(name, quantity)
        self.error = {"is": name, "quantity": TABLE["quantities"].index(quantity)}


def f32(digits):
    return struct.unpack(">f", bytes.fromhex(digits))[0]


def bound(value):
    return LIMITS[value] if isinstance(value, str) else value


# 4.1 Frames


PIECE, PIECE_BYTES, KEYFRAME_MAX = (bound(TABLE["pieces"][name]) for name in ("type", "bytes", "together"))


class Frames:
    """Splits a byte stream into messages, and joins the pieces of long ones."""

    def __init__(self):
        self.data, self.pieces = b"", b""

    def push(self, data):
        self.data += data

    def next(self):
        """(type, body) of the next whole message, or None until more bytes come."""
        while (message := self.next_one()) is not None:
            kind, body = message
            if kind == PIECE:
                refuse_if(len(body) != PIECE_BYTES, "NotCanonical")
            elif self.pieces:
                refuse_if(not body, "NotCanonical")
            refuse_if(self.pieces and len(self.pieces) + len(body) > KEYFRAME_MAX, "TooLong")
            if kind != PIECE:
                body, self.pieces = self.pieces + body, b""
                return kind, body
            self.pieces += body
        return None

    def next_one(self):
        """The next frame."""
        frm = Bytes(self.data)
        try:
            length = frm.varint((1 << 64) - 1)
        except Malformed as why:
            if why.args[0] == "Truncated":
                return None
            raise
        refuse_if(length == 0, "OutOfRange")
        refuse_if(length > LIMITS["MESSAGE_BYTES_MAX"] + 1, "TooLong")
        if len(self.data) - frm.at < length:
            return None
        message = frm.raw(length)
        self.data = self.data[frm.at :]
        return message[0], message[1:]


def framed(kind, body):
    pieces = b""
    while len(body) > PIECE_BYTES:
        pieces += framed(PIECE, body[:PIECE_BYTES])
        body = body[PIECE_BYTES:]
    return pieces + varint(len(body) + 1) + bytes([kind]) + body


# The table's grammar


def decoded(side, kind, body):
    """The meaning of a message of a "client" or a "server"; None for an unknown optional one."""
    codes = TYPES[side + " message"]["codes"]
    row = next((row for row in codes if row["code"] == kind), None)
    if row is None:
        refuse_if(kind < OPTIONAL, "UnknownCode")
        return None
    frm = Body(body)
    msg = {"is": row["name"]} | read_fields(row["fields"], frm)
    frm.finish()
    # Only the motion makes the command refused; all other errors make it malformed (2.6-29).
    for motion in frm.motions:
        check_motion(motion)
    return msg


class Body(Bytes):
    """The bytes of a message, with the motions that were decoded from it."""

    def __init__(self, data):
        super().__init__(data)
        self.motions = []


def read(name, frm, field):
    kind = TYPES.get(name)
    if kind is None:
        return read_primitive(name, field, frm)
    if "fields" in kind:
        msg = read_fields(kind["fields"], frm)
    elif "times" in kind:
        msg = read_times(kind, frm)
    elif "is" in kind:
        return read_primitive(kind["is"], kind, frm)
    else:
        msg = read_coded(name, kind, frm, field)
    if name == "motion":
        frm.motions.append(msg)
    RULES.get(name, lambda msg: None)(msg)
    return msg


def read_coded(name, kind, frm, field):
    code = frm.u8()
    refuse_if(code in field.get("except", ()), "UnknownCode")
    row = next((row for row in kind["codes"] if row["code"] == code), None)
    if row is None:
        refuse_if(code < kind.get("optional", 256), "UnknownCode")
        if name == "command":
            raise UnknownCommand
        # An unknown error has no fields; an unknown scene event may have any.
        return {"is": code, "rest": frm.rest().hex() if name == "event" else ""}
    msg = {"is": row["name"]} | read_fields(row["fields"], frm)
    return msg


def read_fields(fields, frm):
    msg = {}
    for field in fields:
        if is_there(field, msg):
            name = field["name"]
            if "each" in field:
                msg[name] = read_each(field, msg, frm)
            else:
                msg[name] = read(field["type"], frm, field) if "type" in field else read_times(field, frm)
            if "product" in field:
                other, most = field["product"]
                refuse_if(msg[other] * msg[name] > bound(most), "OutOfRange")
    return msg


def read_each(field, msg, frm):
    """A repeated field whose count is the product of earlier fields."""
    name, *counts = field["each"]
    count = math.prod(msg[other] for other in counts)
    # Each element has at least one byte.
    refuse_if(count > len(frm.data) - frm.at, "Truncated")
    return [read(name, frm, {}) for _ in range(count)]


def is_there(field, msg):
    if "when" not in field:
        return True
    path, mask, value = field["when"]
    for name in path.split("."):
        if name not in msg:
            return False
        msg = msg[name]
    return msg & mask == value


def read_times(field, frm):
    name, least, most = field["times"]
    counted = {"least": least, "most": most}
    count = read_primitive(field.get("counted by", "varint"), counted, frm)
    values = [read(name, frm, {}) for _ in range(count)]
    if "rising" in field:
        order = [rank(value) for value in values]
        refuse_if(any(a >= b for a, b in zip(order, order[1:])), "NotCanonical")
    return values


def rank(value):
    if "value" in value:
        return value["id"]
    value = value.get("id", value)
    return (value["index"], value["generation"])


def read_primitive(kind, field, frm):
    start = frm.at
    least, most = bound(field.get("least", 0)), bound(field.get("most", 1 << 64))
    if kind in ("u8", "u16", "u32", "u64"):
        value = int.from_bytes(frm.raw(int(kind[1:]) // 8), "little")
        refuse_if(value & ~field.get("mask", value), "UnknownCode")
        refuse_if(not least <= value <= most, "OutOfRange")
        value = f"{value:016x}" if kind == "u64" else value
    elif kind == "i8":
        value = int.from_bytes(frm.raw(1), "little", signed=True)
        refuse_if(not field["least"] <= value <= field["most"], "OutOfRange")
    elif kind in ("varint", "varint32", "count"):
        natural = {"varint": (1 << 64) - 1, "varint32": WORD - 1, "count": COUNT_MAX}[kind]
        value = frm.varint(min(most, natural))
        refuse_if(value < least, "OutOfRange")
        mask, top = field.get("kinds", (0, 0))
        refuse_if(value & mask > top, "UnknownCode")
    elif kind == "f32":
        value = read_f32(frm)
        refuse_if(field.get("rule") == "finite" and not math.isfinite(f32(value)), "NotFinite")
    elif kind == "vec3":
        value = [read_f32(frm) for _ in range(3)]
        finite = field.get("rule") != "finite" or all(math.isfinite(f32(part)) for part in value)
        refuse_if(not finite, "NotFinite")
    elif kind == "quat":
        value = [read_f32(frm) for _ in range(4)]
    elif kind == "bytes":
        value = frm.rest()
        refuse_if(len(value) > most, "TooLong")
        value = value.hex()
    else:
        length = frm.varint(most, "TooLong")
        value = frm.raw(length)
        refuse_if(length < least, "Text")
        value = read_text(value) if kind == "text" else value.hex()
    refuse_if(field.get("not") == frm.data[start : frm.at].hex(), "NotCanonical")
    return value


def read_f32(frm):
    return frm.raw(4)[::-1].hex()


NAME = set(b"abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_./")


def read_text(data):
    refuse_if(any(byte not in NAME for byte in data), "Text")
    return data.decode("ascii")


# Rules that the table names


def motion_of(msg):
    """The thirteen f32s of a motion, as digits."""
    return [*msg["position"], *msg.get("rotation", IDENTITY), *msg.get("linear", STILL), *msg.get("angular", STILL)]


def check_motion(msg):
    """RECKONING 1.6-1; the error has the quantity of the first fault, for 2.6-29."""
    numbers = [f32(part) for part in motion_of(msg)]
    parts = {"position": numbers[:3], "rotation": numbers[3:7], "linear velocity": numbers[7:10], "angular velocity": numbers[10:]}
    for quantity, part in parts.items():
        finite = all(math.isfinite(number) for number in part)
        if not finite or quantity == "rotation" and not is_unit(part):
            raise Malformed("NotFinite", quantity)


def is_unit(quaternion):
    return abs(reckoning.length4(quaternion) - 1) <= SLACK


def check_range(msg):
    refuse_if(msg["first"] + msg["count"] > LIMITS["INDICES_MAX"], "OutOfRange")


def check_joint(msg):
    refuse_if(msg["flags"] & 16 and not 1 <= msg["flags"] & 7 <= 3, "UnknownCode")


def check_groups(msg):
    refuse_if(msg["members"] == msg["touches"] == WORD - 1, "NotCanonical")


def check_character(msg):
    refuse_if(msg["flags"] & 6 == 4, "UnknownCode")


def check_inertia(msg):
    if msg["is"] == "none":
        return
    moments = [f32(part) for part in msg["moments"]]
    frame = [f32(part) for part in msg.get("frame", IDENTITY)]
    inertia = reckoning.Inertia.of(moments, frame)
    refuse_if(inertia is None, "OutOfRange")
    refuse_if(inertia.is_equal(), "NotCanonical")


def check_track_payload(msg):
    if msg["is"] == "packed":
        bits = BitReader(bytes.fromhex(msg["keyframe"]))
        whole = read_keyframe(bits)
        bits.finish()
        refuse_if("body_state" in whole, "NotCanonical")
    if msg["is"] == "rest":
        refuse_if(msg["anchor"]["present"] & 6, "NotCanonical")


def check_scene_event(msg):
    """Shapes, body descriptions and joints outside section 7 make a scene event malformed (4.6-1)."""
    try:
        if msg["is"] == "ShapeAdded":
            check_numbers("shape", msg["shape"])
        elif msg["is"] == "BodyPlaced":
            check_numbers("body desc", msg["desc"])
        elif msg["is"] == "JointAdded":
            check_numbers("joint", msg["joint"])
    except Refused as why:
        raise Malformed("OutOfRange") from why


def check_queries(queries):
    """4.14-3"""
    cost = sum(query["hits"] * (LIMITS["SHAPE_CAST_COST"] if query["is"] == "shape cast" else 1) for query in queries)
    refuse_if(cost > LIMITS["QUERY_COST_MAX"], "OutOfRange")


RULES = {
    "id range": check_range,
    "inertia": check_inertia,
    "collision groups": check_groups,
    "joint": check_joint,
    "character": check_character,
    "event": check_scene_event,
    "body placed": check_scene_event,
    "queries": check_queries,
    "track payload": check_track_payload,
}


# 4.5 and 7: limits of numbers


def check_command(msg):
    """Raises Refused for the first number that is outside section 7."""
    if msg["is"] in ("Create", "Joined"):
        check_config(msg["config"])
    elif msg["is"] == "Command":
        command = msg["command"]
        row = next(row for row in TYPES["command"]["codes"] if row["name"] == command["is"])
        check_fields(row["fields"], command)
    elif msg["is"] == "Query":
        for query in msg["queries"]:
            check_numbers("query", query)


def check_numbers(name, msg):
    kind = TYPES.get(name)
    if kind is None or not isinstance(msg, dict):
        return
    if name == "joint":
        return check_whole_joint(msg)
    if "codes" in kind:
        kind = next(row for row in kind["codes"] if row["name"] == msg["is"])
    if name == "shape":
        return check_shape(kind["fields"], msg)
    check_fields(kind["fields"], msg)
    if name == "mass":
        check_moments(msg)
    if name == "query" and msg["is"] == "ray" and not any(f32(part) for part in msg["translation"]):
        raise Refused("OutOfRange", "position")


def check_shape(fields, msg):
    """2.6-11: the order of the checks of a shape."""
    counts = 3 if msg["is"] == "heights" else 2 if msg["is"] == "mesh" else 0
    check_fields(fields[:counts], msg)
    if msg["is"] == "heights":
        check_length(msg, "rows", "row spacing")
        check_fields(fields[counts : counts + 1], msg)
        check_length(msg, "columns", "column spacing")
    elif msg["is"] == "mesh":
        check_triangles(msg)
    check_fields(fields[counts:], msg)
    if msg["is"] == "hull":
        check_thickness([[f32(part) for part in point] for point in msg["points"]])
    elif msg["is"] == "compound" and sum(size(part["shape"]) for part in msg["parts"]) > LIMITS["PARTS_BYTES_MAX"]:
        raise Refused("OutOfRange", "parts of a compound")


def size(shape):
    """2.6-10, of a shape that is no compound."""
    points, triangles = len(shape.get("points", ())), len(shape.get("triangles", ()))
    return 48 + 12 * (points + triangles) + 4 * len(shape.get("heights", ()))


def check_fields(fields, msg):
    for field in fields:
        if field["name"] in msg:
            check_field(field, msg[field["name"]])


def check_field(field, value):
    quantity = field.get("quantity")
    if quantity is None:
        several = field.get("times", field.get("each"))
        for one in value if several else [value]:
            check_numbers(several[0] if several else field["type"], one)
        return None
    if quantity == "rotation":
        return check_rotation([f32(part) for part in value])
    if isinstance(value, int):
        if not bound(field["from"]) <= value <= bound(field["to"]):
            raise Refused("OutOfRange", quantity)
        return None
    parts = flat(value)
    most = bound(field["to"]) if "to" in field else math.inf
    least = bound(field["from"]) if "from" in field else -most
    most, least = to_f32(most), to_f32(least)
    for part in parts:
        check_scalar(f32(part), least, most, quantity)


def flat(value):
    if isinstance(value, str):
        return [value]
    return [part for one in value for part in flat(one)]


def to_f32(value):
    return value if math.isinf(value) else struct.unpack("<f", struct.pack("<f", value))[0]


def check_scalar(value, least, most, quantity):
    if not math.isfinite(value):
        raise Refused("NotFinite", quantity)
    if not least <= value <= most:
        raise Refused("OutOfRange", quantity)


def check_rotation(parts):
    """Of a rotation or a direction."""
    if not is_unit([*parts, 0.0][:4]):
        raise Refused("NotFinite", "rotation")


PI = f32("40490fdb")


def check_whole_joint(msg):
    for side in ("first", "second"):
        for part in msg[side + " anchor"]:
            check_scalar(f32(part), -LIMITS["EXTENT_MAX"], LIMITS["EXTENT_MAX"], "anchor of a joint")
        check_rotation([f32(part) for part in msg.get(side + " rotation", IDENTITY)])
    kind = msg["flags"] & 7
    if kind == 4:
        check_scalar(f32(msg["length"]), to_f32(LIMITS["EXTENT_MIN"]), LIMITS["EXTENT_MAX"], "limit of a joint")
    if kind == 5:
        check_fields(TYPES["spring"]["fields"], msg["spring"])
    locked = msg["locked"] if kind == 6 else (63, 7, 55, 62, 63, 63)[kind]
    for axis in range(6):
        check_limits(axis, locked, msg)
    for axis in range(6):
        if f"motor {axis}" in msg:
            check_motor(axis, locked, bool(limits_of(axis, msg)), msg[f"motor {axis}"])
    if "strength" in msg:
        check_fields(TYPES["strength"]["fields"], msg["strength"])


NAMED = {0: "limits of the translation", 3: "limits about x", 4: "limits about y", 5: "limits about z"}


def reach(axis, limited):
    return LIMITS["EXTENT_MAX"] if axis < 3 else 2 * PI if limited else PI


def limits_of(axis, msg):
    names = [f"limits {axis}", NAMED.get(axis), "limits of the rotation" if axis == 3 else None]
    return [msg[name] for name in names if name in msg]


def check_limits(axis, locked, msg):
    for limits in limits_of(axis, msg):
        if locked >> axis & 1:
            raise Refused("OutOfRange", "limit of a joint")
        # 2.6-24, 7: of a rotation within a turn, and at most a turn apart.
        least, greatest, most = f32(limits["least"]), f32(limits["most"]), LIMITS["EXTENT_MAX"] if axis < 3 else 2 * PI
        check_scalar(least, -most, most, "limit of a joint")
        check_scalar(greatest, least, most, "limit of a joint")
        if axis >= 3:
            check_scalar(to_f32(greatest - least), 0, most, "limit of a joint")


def check_motor(axis, locked, limited, motor):
    """2.6-25, 7. Ropes and springs have no motors."""
    if locked >> axis & 1:
        raise Refused("OutOfRange", "motor of a joint")
    fastest = LIMITS["LINEAR_MAX" if axis < 3 else "ANGULAR_MAX"]
    check_scalar(f32(motor["position"]), -reach(axis, limited), reach(axis, limited), "motor of a joint")
    check_scalar(f32(motor["velocity"]), -fastest, fastest, "motor of a joint")
    check_fields([field for field in TYPES["motor"]["fields"] if "to" in field], motor)


def check_moments(msg):
    """2.6-14: bounds for each kilogram, each one multiplication in f32; then what no body exceeds."""
    mass = f32(msg["mass"])
    least, most = (to_f32(mass * to_f32(LIMITS[name])) for name in ("GYRATION_MIN", "GYRATION_MAX"))
    moments = [f32(part) for part in msg.get("moments", ())]
    for part in moments:
        check_scalar(part, least, most, "moments of inertia")
    for place, part in enumerate(moments):
        others = sum(moments[:place] + moments[place + 1:])
        if 1000 * part > 1001 * others:
            raise Refused("OutOfRange", "moments of inertia")


def check_length(heights, count, spacing):
    """2.6-7: the length of a height field in one direction, in f32."""
    length = to_f32((heights[count] - 1) * f32(heights[spacing]))
    check_scalar(length, to_f32(LIMITS["EXTENT_MIN"]), LIMITS["EXTENT_MAX"], "extent")


def check_triangles(mesh):
    """2.6-8"""
    places = [place for triangle in mesh["triangles"] for place in triangle.values()]
    if any(place >= mesh["point count"] for place in places):
        raise Refused("OutOfRange", "point of a triangle")


def check_thickness(points):
    """2.6-2: distance from the plane through the first point, the farthest, and the farthest from their line."""

    def away(point):
        return [a - b for a, b in zip(point, points[0])]

    def squared(v):
        return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]

    def cross(a, b):
        return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]

    radius = max(math.sqrt(squared(point)) for point in points)
    along = max((away(point) for point in points), key=squared)
    normal = max((cross(along, away(point)) for point in points), key=squared)
    length = math.sqrt(squared(normal))
    reach = max(abs(sum(a * b for a, b in zip(normal, away(point)))) for point in points)
    thickness = reach / length if length > 0 else 0.0
    if thickness < max(to_f32(LIMITS["EXTENT_MIN"]), radius * to_f32(LIMITS["HULL_FLATNESS"])):
        raise Refused("OutOfRange", "thickness of a hull")


def check_config(config):
    ticks, seconds = config["ticks"], config["seconds"]
    if ticks > seconds * LIMITS["RATE_MAX"] or seconds > ticks * LIMITS["STEP_SECONDS_MAX"]:
        raise Refused("OutOfRange", "rate")
    if config["substeps"] > LIMITS["SUBSTEPS_MAX"]:
        raise Refused("OutOfRange", "substeps")
    check_fields(TYPES["scene config"]["fields"], config)
    if config["publish interval"] > 1 and config["publish interval"] * seconds > ticks * LIMITS["PUBLISH_SECONDS_MAX"]:
        raise Refused("OutOfRange", "publish interval")
    if config["lookahead"] > LIMITS["LOOKAHEAD_TICKS_MAX"]:
        raise Refused("OutOfRange", "lookahead")
    if config["stepping"] == 0 and config["lookahead"]:
        raise Refused("OutOfRange", "lookahead of a lockstep scene")


# Writing


def encoded(side, msg):
    """The framed bytes of a message."""
    row = next(row for row in TYPES[side + " message"]["codes"] if row["name"] == msg["is"])
    return framed(row["code"], write_fields(row["fields"], msg))


def write(name, value, field):
    kind = TYPES.get(name)
    if kind is None:
        return write_primitive(name, value)
    if "fields" in kind:
        return write_fields(kind["fields"], value)
    if "times" in kind:
        return write_times(kind, value)
    if "is" in kind:
        return write_primitive(kind["is"], value)
    if isinstance(value["is"], int):
        return bytes([value["is"]]) + bytes.fromhex(value["rest"])
    row = next(row for row in kind["codes"] if row["name"] == value["is"])
    return bytes([row["code"]]) + write_fields(row["fields"], value)


def write_fields(fields, msg):
    out = b""
    for field in fields:
        if field["name"] in msg:
            value = msg[field["name"]]
            if "each" in field:
                out += b"".join(write(field["each"][0], one, {}) for one in value)
            else:
                out += write(field["type"], value, field) if "type" in field else write_times(field, value)
    return out


def write_times(field, values):
    count = write_primitive(field.get("counted by", "varint"), len(values))
    return count + b"".join(write(field["times"][0], value, {}) for value in values)


def write_primitive(kind, value):
    if kind == "u64":
        return bytes.fromhex(value)[::-1]
    if kind in ("u8", "u16", "u32"):
        return value.to_bytes(int(kind[1:]) // 8, "little")
    if kind == "i8":
        return value.to_bytes(1, "little", signed=True)
    if kind in ("varint", "varint32", "count"):
        return varint(value)
    if kind == "f32":
        return bytes.fromhex(value)[::-1]
    if kind in ("vec3", "quat"):
        return b"".join(bytes.fromhex(part)[::-1] for part in value)
    data = value.encode("ascii") if kind == "text" else bytes.fromhex(value)
    return data if kind == "bytes" else varint(len(data)) + data
