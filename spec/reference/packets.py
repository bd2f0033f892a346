"""PROTOCOL 5 in Python: encodes and decodes datagrams, written from the document only.

It is meant for reading beside the document, not for speed. A datagram is a dict, as in the vectors.
"""

import json
import struct
from functools import cache
from pathlib import Path

import reckoning

TABLES = json.loads((Path(__file__).resolve().parent.parent / "tables" / "packets.json").read_text(encoding="utf-8"))

INDEX_BITS, INDICES = 20, 1 << 20
AGE_MAX = 1 << 30
UPDATES_MAX, RECORDS_MAX, LOST_MAX, PARTS_MAX = 400, 9200, 64, 64
SPAN, ROWS, SYMBOL_MAX, DATAGRAM_MAX = 32, 128, 1136, 1150
POSITION_LIMIT, VELOCITY_LIMIT, RESIDUAL_LIMIT, TURN_LIMIT = 1 << 30, 1 << 24, 1 << 26, 1 << 10
VELOCITY_EXPONENT_MAX = 12
# Contexts of numbers.
REST_UPDATE_AGE, POSITION, TURN, VELOCITY, COARSENESS = 7, 8, 13, 22, 62
LENGTH, ACCELERATION_EXPONENT, ACCELERATION = 66, 71, 72
GOLOMB_MAX = 3 << 30
ALPHABET_BITS, ESCAPE = 12, 17
END, ASSIGNMENT, REST_UPDATE, KEYFRAME, PENDING_MAX = 17, 16, 13, 12, 11
WORD = 1 << 32


class Malformed(Exception):
    """The bytes are refused; the argument is the reason as a word."""


def refuse_if(wrong, why):
    if wrong:
        raise Malformed(why)


# 5.3 The range coder


def shortest_tail(low, size):
    for zeros in (32, 24, 16, 8):
        tail = -(-low >> zeros) << zeros
        if tail - low < size:
            return tail
    return low


class RangeWriter:
    def __init__(self):
        self.done, self.low, self.range = bytearray(), 0, WORD - 1

    def symbol(self, start, size, bits):
        part = self.range >> bits
        self.low += part * start
        self.range = part * size
        if self.low >= WORD:
            self.low -= WORD
            self.carry()
        while self.range < 1 << 24:
            self.done.append(self.low >> 24)
            self.low = self.low << 8 & WORD - 1
            self.range <<= 8

    def carry(self):
        place = len(self.done) - 1
        while self.done[place] == 255:
            self.done[place] = 0
            place -= 1
        self.done[place] += 1

    def bits(self, value, count):
        if count > 16:
            self.symbol(value >> 16, 1, count - 16)
            value, count = value & 0xFFFF, 16
        if count:
            self.symbol(value, 1, count)

    def finish(self):
        tail = shortest_tail(self.low, self.range)
        if tail >= WORD:
            self.carry()
        return bytes(self.done + (tail % WORD).to_bytes(4, "big")).rstrip(b"\0")


class RangeReader:
    def __init__(self, data):
        self.data, self.taken, self.window, self.offset, self.range = data, 0, 0, 0, WORD - 1
        for _ in range(4):
            self.take()

    def take(self):
        byte = self.data[self.taken] if self.taken < len(self.data) else 0
        self.taken += 1
        self.window = (self.window << 8 | byte) % WORD
        self.offset = (self.offset << 8 | byte) % WORD

    def part(self, bits):
        part = self.offset // (self.range >> bits)
        refuse_if(part >> bits, "NotCanonical")
        return part

    def symbol(self, start, size, bits):
        part = self.range >> bits
        self.offset -= part * start
        self.range = part * size
        while self.range < 1 << 24:
            self.range <<= 8
            self.take()

    def bits(self, count):
        if count > 16:
            high = self.bits(count - 16)
            return high << 16 | self.bits(16)
        if count == 0:
            return 0
        value = self.part(count)
        self.symbol(value, 1, count)
        return value

    def finish(self):
        refuse_if(len(self.data) > self.taken, "Trailing")
        refuse_if(self.offset >= self.range or self.data[-1:] == b"\0", "NotCanonical")
        refuse_if(shortest_tail(self.window - self.offset, self.range) != self.window, "NotCanonical")


def write_code(starts, code, to):
    to.symbol(starts[code], starts[code + 1] - starts[code], ALPHABET_BITS)


def read_code(starts, frm):
    part = frm.part(ALPHABET_BITS)
    code = max(place for place, start in enumerate(starts) if start <= part)
    frm.symbol(starts[code], starts[code + 1] - starts[code], ALPHABET_BITS)
    return code


# 5.4 Numbers


def ilog2(number):
    return number.bit_length() - 1


def group(context):
    if context >= ACCELERATION:
        return 3
    firsts = (POSITION, TURN, VELOCITY, COARSENESS)
    return sum(context >= first for first in firsts) % len(firsts)


class Model:
    def __init__(self):
        self.expected = list(TABLES["expected"])

    def alphabet(self, context):
        x = self.expected[context] // 16 + 1
        raw = max(ilog2(x) - 6, 0)
        octave = ilog2(x) - raw
        quarter = ((x >> raw) << 2 >> octave) & 3
        return raw, TABLES["shapes"][28 * group(context) + 4 * octave + quarter]

    def learn(self, context, number):
        self.expected[context] += (256 * min(number, 4095) - self.expected[context]) >> 3

    def write(self, context, number, to):
        raw, starts = self.alphabet(context)
        high = number >> raw
        write_code(starts, min(high, ESCAPE), to)
        if high >= ESCAPE:
            rest = high - ESCAPE + 1
            for _ in range(ilog2(rest)):
                to.bits(1, 1)
            to.bits(0, 1)
            to.bits(rest - (1 << ilog2(rest)), ilog2(rest))
        to.bits(number & (1 << raw) - 1, raw)
        self.learn(context, number)

    def read(self, context, frm):
        raw, starts = self.alphabet(context)
        high = read_code(starts, frm)
        if high == ESCAPE:
            width = 0
            while frm.bits(1):
                width += 1
                refuse_if(width > 30, "OutOfRange")
            high += frm.bits(width) + (1 << width) - 1
        refuse_if(high << raw >= WORD, "OutOfRange")
        number = high << raw | frm.bits(raw)
        self.learn(context, number)
        return number


# 5.6 Updates


def is_late(age):
    return int(age > 2)


def follows(part, total):
    return 0 if total == 0 else 1 if total <= part else 2 if total <= 3 * part else 3


class Walk:
    """The contexts of a correction's numbers, in order."""

    def __init__(self, kind, age):
        self.kind, self.late = kind, is_late(age)
        self.triple = self.part = self.total = self.largest = 0

    def context(self):
        slot = 1 + follows(self.part, self.total) if self.part else 0
        if self.triple == 0:
            return POSITION + slot
        if self.triple == 1:
            n = self.largest
            first = 4 if n == 0 else 5 + ilog2(n) if n < 8 else 8
            return TURN + (slot - 1 if self.part else first)
        return VELOCITY + (4 * (self.kind // 2) + 2 * self.late + self.triple - 2) * 5 + slot

    def step(self, size):
        if self.triple == 0:
            self.largest = max(self.largest, size)
        self.total += size
        self.part += 1
        if self.part == 3:
            self.triple, self.part, self.total = self.triple + 1, 0, 0


TRIPLES = ("position", "turn", "linear", "angular")
LIMITS = (RESIDUAL_LIMIT, TURN_LIMIT, VELOCITY_LIMIT, VELOCITY_LIMIT)
CONSTANT_ACCELERATION = 5  # the predictor
# By form: the mode, the predictor, and whether velocities are encoded.
FORMS = [
    ("same", None, False),
    ("same", None, True),
    ("world", 0, False),
    *[("world", predictor, moved) for predictor in (1, 2, 3, 4) for moved in (False, True)],
    ("attached", None, False),
    None,  # a keyframe track
    None,  # is_rest
    ("world", CONSTANT_ACCELERATION, False),
    ("world", CONSTANT_ACCELERATION, True),
]


def acceleration_context(part, total):
    return ACCELERATION + (1 + follows(part, total) if part else 0)


def coarseness_context(kind, age):
    return COARSENESS + 2 * (kind // 2) + is_late(age)


def length_context(place, lengths):
    """The context of a step of a rest correction, and the reference length of its own length."""
    part, fixed = ((0, 14), (1, None), (1, None), (2, 19), (3, None), (3, None), (4, 1))[place]
    return LENGTH + part, lengths[place - 1] if fixed is None else fixed


def kind_of(mode, moved):
    return 2 * (mode != "same") + moved


class UpdateCoder:
    def __init__(self):
        self.model, self.row, self.begun, self.parent = Model(), 0, 0, None

    def went_on(self, form):
        self.begun, self.row = 1, {0: 1, 1: 2}.get(form, 3)

    def write(self, gap, update, to):
        modes = TABLES["modes"][self.row]
        if "keyframe" in update:
            write_code(modes, KEYFRAME, to)
            self.model.write(self.begun, gap, to)
            to.bits(update["body"], INDEX_BITS)
            write_keyframe(update["keyframe"], to)
            return self.went_on(KEYFRAME)
        moved = "linear" in update
        is_rest = "negated" in update
        form = REST_UPDATE if is_rest else FORMS.index((update["mode"], update.get("predictor"), moved))
        if update["body"] is not None:
            write_code(modes, ASSIGNMENT, to)
        write_code(modes, form, to)
        self.model.write(self.begun, gap, to)
        if update["body"] is not None:
            to.bits(update["body"], INDEX_BITS)
        if is_rest:
            self.write_rest_update(update, to)
            return self.went_on(REST_UPDATE)
        kind = kind_of(update["mode"], moved)
        self.model.write(2 + kind, update["age"] - 1, to)
        self.write_parent(update, to)
        if update.get("predictor") == CONSTANT_ACCELERATION:
            self.write_acceleration(update["acceleration"], to)
        if moved:
            self.model.write(coarseness_context(kind, update["age"]), update["velocity_exponent"], to)
        walk = Walk(kind, update["age"])
        for name in TRIPLES[: 4 if moved else 2]:
            for number in update[name]:
                self.model.write(walk.context(), abs(number), to)
                if number:
                    to.bits(int(number < 0), 1)
                walk.step(abs(number))
        self.went_on(form)

    def write_acceleration(self, acceleration, to):
        self.model.write(ACCELERATION_EXPONENT, acceleration["exponent"], to)
        total = 0
        for part, number in enumerate(acceleration["steps"]):
            self.model.write(acceleration_context(part, total), abs(number), to)
            if number:
                to.bits(int(number < 0), 1)
            total += abs(number)

    def read_acceleration(self, frm):
        acceleration, total = {"exponent": self.model.read(ACCELERATION_EXPONENT, frm), "steps": []}, 0
        for part in range(3):
            size = self.model.read(acceleration_context(part, total), frm)
            refuse_if(size > reckoning.ACCELERATION_LIMIT, "OutOfRange")
            acceleration["steps"].append(-size if size and frm.bits(1) else size)
            total += size
        refuse_if(acceleration["exponent"] > reckoning.ACCELERATION_EXPONENT_MAX, "OutOfRange")
        return acceleration

    def write_rest_update(self, update, to):
        self.model.write(REST_UPDATE_AGE, update["age"] - 1, to)
        to.bits(update["negated"], 1)
        steps, lengths = update["steps"], [0] * 7
        for place, step in enumerate(steps):
            lengths[place] = abs(step).bit_length()
            context, expected = length_context(place, lengths)
            off = lengths[place] - expected
            self.model.write(context, 2 * off if off >= 0 else -2 * off - 1, to)
            if step:
                to.bits(int(step < 0), 1)
                to.bits(abs(step) & (1 << lengths[place] - 1) - 1, lengths[place] - 1)

    def read_rest_update(self, update, frm):
        update["age"] = self.read_age(REST_UPDATE_AGE, frm)
        update["negated"], update["steps"], lengths = frm.bits(1), [], [0] * 7
        for place in range(7):
            context, expected = length_context(place, lengths)
            off = self.model.read(context, frm)
            lengths[place] = expected + (off // 2 if off % 2 == 0 else -(off // 2) - 1)
            refuse_if(not 0 <= lengths[place] <= 31, "OutOfRange")
            step = 0
            if lengths[place]:
                negative = frm.bits(1)
                step = frm.bits(lengths[place] - 1) | 1 << lengths[place] - 1
                step = -step if negative else step
            update["steps"].append(step)

    def read_age(self, context, frm):
        age = self.model.read(context, frm) + 1
        refuse_if(age > AGE_MAX, "OutOfRange")
        return age

    def write_parent(self, update, to):
        if update["mode"] == "same":
            return
        if update["mode"] == "world":
            to.bits(int(update["parent_age"] is not None), 1)
        else:
            again = self.parent == update["parent"]
            if self.parent is not None:
                to.bits(int(again), 1)
            if not again:
                to.bits(update["parent"], INDEX_BITS)
            self.parent = update["parent"]
        if update["parent_age"] is not None:
            self.model.write(6, update["parent_age"], to)

    def end(self, to):
        write_code(TABLES["modes"][self.row], END, to)

    def read(self, frm):
        """The gap and the update, or None at the end."""
        modes = TABLES["modes"][self.row]
        form, update = read_code(modes, frm), {"body": None}
        if form == END:
            return None
        assignment = form == ASSIGNMENT
        if assignment:
            form = read_code(modes, frm)
            refuse_if(form in (ASSIGNMENT, KEYFRAME, END), "NotCanonical")
        gap = self.model.read(self.begun, frm)
        if assignment:
            update["body"] = frm.bits(INDEX_BITS)
        if form == KEYFRAME:
            update["body"] = frm.bits(INDEX_BITS)
            update["keyframe"] = read_keyframe(frm)
        elif form == REST_UPDATE:
            self.read_rest_update(update, frm)
        else:
            self.read_correction(form, update, frm)
        self.went_on(form)
        return gap, update

    def read_correction(self, form, update, frm):
        mode, predictor, moved = FORMS[form]
        kind = kind_of(mode, moved)
        age = self.read_age(2 + kind, frm)
        update |= {"mode": mode, "age": age}
        if mode == "world":
            update["predictor"] = predictor
            update["parent_age"] = self.read_parent_age(frm) if frm.bits(1) else None
            if predictor == CONSTANT_ACCELERATION:
                update["acceleration"] = self.read_acceleration(frm)
        elif mode == "attached":
            if self.parent is None or not frm.bits(1):
                parent = frm.bits(INDEX_BITS)
                refuse_if(parent == self.parent, "NotCanonical")
                self.parent = parent
            update["parent"] = self.parent
            update["parent_age"] = self.read_parent_age(frm)
        limits = LIMITS
        if moved:
            velocity_exponent = update["velocity_exponent"] = self.model.read(coarseness_context(kind, age), frm)
            limits = LIMITS[:2] + (VELOCITY_LIMIT >> min(velocity_exponent, VELOCITY_EXPONENT_MAX),) * 2
        walk = Walk(kind, age)
        for name in TRIPLES[: 4 if moved else 2]:
            update[name] = []
            for _ in range(3):
                size = self.model.read(walk.context(), frm)
                refuse_if(size >= 1 << 31, "OutOfRange")
                update[name].append(-size if size and frm.bits(1) else size)
                walk.step(size)
        refuse_if(moved and velocity_exponent > VELOCITY_EXPONENT_MAX, "OutOfRange")
        for name, limit in zip(TRIPLES, limits):
            refuse_if(any(abs(number) > limit for number in update.get(name, ())), "OutOfRange")

    def read_parent_age(self, frm):
        age = self.model.read(6, frm)
        refuse_if(age > AGE_MAX, "OutOfRange")
        return age


# 5.1, 5.2 Bits


class BitWriter:
    def __init__(self):
        self.value, self.count = 0, 0

    def bits(self, value, count):
        self.value |= value << self.count
        self.count += count

    def finish(self):
        return self.value.to_bytes((self.count + 7) // 8, "little")


class BitReader:
    def __init__(self, data):
        self.value, self.left = int.from_bytes(data, "little"), 8 * len(data)

    def bits(self, count):
        refuse_if(count > self.left, "Truncated")
        value = self.value & (1 << count) - 1
        self.value >>= count
        self.left -= count
        return value

    def finish(self):
        refuse_if(self.left >= 8, "Trailing")
        refuse_if(self.value, "NotCanonical")


def write_golomb(number, order, to):
    s = number + (1 << order)
    extra = ilog2(s) - order
    for _ in range(extra):
        to.bits(1, 1)
    to.bits(0, 1)
    to.bits(s - (1 << extra + order), extra + order)


def read_golomb(order, frm):
    extra = 0
    while frm.bits(1):
        extra += 1
        refuse_if(extra + order > 31, "OutOfRange")
    number = (1 << extra + order) + frm.bits(extra + order) - (1 << order)
    refuse_if(number > GOLOMB_MAX, "OutOfRange")
    return number


def write_signed(numbers, order, to):
    for number in numbers:
        write_golomb(2 * number if number >= 0 else -2 * number - 1, order, to)


def read_signed(order, frm):
    numbers = [read_golomb(order, frm) for _ in range(3)]
    return [number >> 1 if number % 2 == 0 else -(number >> 1) - 1 for number in numbers]


# 5.5 Keyframes


def write_keyframe(keyframe, to):
    to.bits(keyframe["predictor"], 3)
    to.bits(int(keyframe["parent"] is not None), 1)
    if keyframe["parent"] is not None:
        to.bits(keyframe["parent"][0], INDEX_BITS)
        to.bits(keyframe["parent"][1], 16)
    if keyframe["predictor"] == CONSTANT_ACCELERATION:
        to.bits(keyframe["acceleration"]["exponent"], 4)
        write_signed(keyframe["acceleration"]["steps"], 6, to)
    to.bits(int("body_state" in keyframe), 1)
    if "body_state" in keyframe:
        for part in keyframe["body_state"][: 13 if keyframe["predictor"] else 7]:
            to.bits(int(part, 16), 32)
        return
    write_signed(keyframe["position"], 14, to)
    to.bits(keyframe["largest"], 2)
    for other in keyframe["others"]:
        to.bits(other + 524288, 20)
    if keyframe["predictor"]:
        write_signed(keyframe["linear"], 6, to)
        write_signed(keyframe["angular"], 6, to)


def read_keyframe(frm):
    predictor = frm.bits(3)
    refuse_if(predictor > CONSTANT_ACCELERATION, "UnknownCode")
    parent = [frm.bits(INDEX_BITS), frm.bits(16)] if frm.bits(1) else None
    keyframe = {"predictor": predictor, "parent": parent}
    if predictor == CONSTANT_ACCELERATION:
        acceleration = keyframe["acceleration"] = {"exponent": frm.bits(4), "steps": read_signed(6, frm)}
        refuse_if(reckoning.Acceleration.of(acceleration["steps"], acceleration["exponent"]) is None, "OutOfRange")
    if frm.bits(1):
        parts = [frm.bits(32) for _ in range(13 if predictor else 7)]
        parts += [0] * (13 - len(parts))
        motion = [struct.unpack(">f", part.to_bytes(4, "big"))[0] for part in parts]
        refuse_if(reckoning.body_state_motion(motion) is None, "NotFinite")
        keyframe["body_state"] = [f"{part:08x}" for part in parts]
    else:
        keyframe["position"] = read_signed(14, frm)
        keyframe["largest"] = frm.bits(2)
        keyframe["others"] = [frm.bits(20) - 524288 for _ in range(3)]
        refuse_if(not reckoning.is_packed(keyframe["largest"], tuple(keyframe["others"])), "NotCanonical")
        keyframe["linear"] = read_signed(6, frm) if predictor else [0, 0, 0]
        keyframe["angular"] = read_signed(6, frm) if predictor else [0, 0, 0]
        for name, limit in (("position", POSITION_LIMIT), ("linear", VELOCITY_LIMIT), ("angular", VELOCITY_LIMIT)):
            refuse_if(any(abs(number) > limit for number in keyframe[name]), "OutOfRange")
    refuse_if(parent is not None and (predictor or "body_state" in keyframe), "OutOfRange")
    refuse_if(predictor == CONSTANT_ACCELERATION and "body_state" in keyframe, "OutOfRange")
    return keyframe


# 5.7 to 5.12 Datagrams


class Bytes:
    def __init__(self, data):
        self.data, self.at = data, 0

    def raw(self, count):
        refuse_if(self.at + count > len(self.data), "Truncated")
        self.at += count
        return self.data[self.at - count : self.at]

    def u8(self):
        return self.raw(1)[0]

    def low16(self):
        return int.from_bytes(self.raw(2), "little")

    def varint(self, most, why="OutOfRange"):
        value = shift = 0
        while True:
            byte = self.u8()
            refuse_if(byte == 0 and shift, "NotCanonical")
            refuse_if(shift == 63 and byte > 1, "OutOfRange")
            value |= (byte & 127) << shift
            if byte < 128:
                break
            shift += 7
        refuse_if(value > most, why)
        return value

    def rest(self):
        return self.raw(len(self.data) - self.at)

    def finish(self):
        refuse_if(self.at < len(self.data), "Trailing")


def varint(value):
    out = bytearray()
    while value >= 128:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes(out + bytes([value]))


OVER_BUDGET = (11, 12)
LARGE = 15


def eighths(code):
    """The factor of an error scale code, in eighths; None if it is unbounded [5.17]."""
    refuse_if(code == 0, "NotCanonical")
    return None if code == 255 else (8 + code % 8) << code // 8


def error_scale_of(factor):
    return 255 if factor is None else next(code for code in range(1, 255) if eighths(code) == factor)


def read_head(frm):
    """Kind and stream [5.8]."""
    first = frm.u8()
    kind, stream = first & 15, first >> 4
    refuse_if(kind == 8 or kind > 9 and kind not in OVER_BUDGET, "UnknownCode")
    if stream == LARGE:
        stream += frm.varint(WORD - 1)
        refuse_if(stream >= WORD, "OutOfRange")
    return kind, stream


def head_of(kind, stream):
    small = min(stream, LARGE)
    return bytes([kind | small << 4]) + (varint(stream - LARGE) if small == LARGE else b"")


def decoded(datagram):
    refuse_if(len(datagram) > DATAGRAM_MAX, "TooLong")
    frm = Bytes(datagram)
    kind, stream = read_head(frm)
    msg = {"stream": stream, "kind": kind}
    if kind in OVER_BUDGET:
        msg["error_scale_eighths"] = eighths(frm.u8())
    if kind in (0, 1, 11):
        msg |= {name: frm.low16() for name in ("number", "tick", "events")}
        coder, update_coder, alias, msg["updates"] = RangeReader(frm.rest()), UpdateCoder(), 0, []
        while (read := update_coder.read(coder)) is not None:
            refuse_if(len(msg["updates"]) == UPDATES_MAX, "TooLong")
            gap, update = read
            alias += gap
            refuse_if(alias >= INDICES, "OutOfRange")
            msg["updates"].append({"alias": alias} | update)
            alias += 1
        coder.finish()
    elif kind in (2, 12):
        msg |= {name: frm.low16() for name in ("next", "tick", "events")}
        frm.finish()
    elif kind == 3:
        msg |= {name: frm.low16() for name in ("lost", "tick", "events")}
        msg |= {"part": frm.u8(), "parts": frm.u8()}
        refuse_if(msg["part"] >= msg["parts"] or msg["parts"] > PARTS_MAX, "OutOfRange")
        read_records(msg, frm)
    elif kind in (4, 5):
        msg |= {name: frm.low16() for name in ("number", "tick", "events")}
        read_full(msg, frm)
    elif kind == 7:
        msg |= {name: frm.low16() for name in ("next", "tick", "events")}
        msg["checksum"] = frm.raw(8)[::-1].hex()
        frm.finish()
    elif kind == 6:
        msg |= {"next": frm.low16(), "abandoned": frm.low16(), "repair_symbols": frm.u8()}
        refuse_if(msg["repair_symbols"] > SPAN, "OutOfRange")
        count = frm.varint(LOST_MAX, "TooLong")
        msg["lost"] = [frm.low16() for _ in range(count)]
        frm.finish()
    elif kind == 9:
        msg |= {"last": frm.low16(), "covered": frm.varint(WORD - 1), "row": frm.u8()}
        refuse_if(msg["covered"] >= 1 << SPAN - 1 or msg["row"] >= ROWS, "OutOfRange")
        symbol = frm.rest()
        refuse_if(len(symbol) > SYMBOL_MAX, "TooLong")
        refuse_if(symbol.endswith(b"\0"), "NotCanonical")
        msg["symbol"] = symbol.hex()
    return msg


def read_full(msg, frm):
    msg["records"] = []
    while frm.at < len(frm.data):
        record = {"index": int.from_bytes(frm.raw(4), "little")}
        refuse_if(record["index"] >= INDICES, "OutOfRange")
        record["motion"] = [frm.raw(4)[::-1].hex() for _ in range(13)]
        numbers = [struct.unpack(">f", bytes.fromhex(part))[0] for part in record["motion"]]
        refuse_if(reckoning.body_state_motion(numbers) is None, "NotFinite")
        msg["records"].append(record)


def read_records(msg, frm):
    count = frm.varint(RECORDS_MAX)
    bits, index, msg["records"] = BitReader(frm.rest()), 0, []
    for _ in range(count):
        index += read_golomb(3, bits)
        alias, age = read_golomb(5, bits) - 1, read_golomb(4, bits)
        refuse_if(index >= INDICES or alias >= INDICES or age > AGE_MAX, "OutOfRange")
        record = {"index": index, "alias": alias if alias >= 0 else None, "age": age}
        msg["records"].append(record | {"keyframe": read_keyframe(bits)})
        index += 1
    bits.finish()


def encoded(msg):
    def low16s(*names):
        return b"".join(msg[name].to_bytes(2, "little") for name in names)

    kind = msg["kind"]
    head = head_of(kind, msg["stream"])
    if kind in OVER_BUDGET:
        head += bytes([error_scale_of(msg["error_scale_eighths"])])
    if kind in (0, 1, 11):
        coder, update_coder, alias = RangeWriter(), UpdateCoder(), 0
        for update in msg["updates"]:
            update_coder.write(update["alias"] - alias, update, coder)
            alias = update["alias"] + 1
        update_coder.end(coder)
        return head + low16s("number", "tick", "events") + coder.finish()
    if kind in (2, 12):
        return head + low16s("next", "tick", "events")
    if kind == 3:
        bits, index = BitWriter(), 0
        for record in msg["records"]:
            write_golomb(record["index"] - index, 3, bits)
            write_golomb(0 if record["alias"] is None else record["alias"] + 1, 5, bits)
            write_golomb(record["age"], 4, bits)
            write_keyframe(record["keyframe"], bits)
            index = record["index"] + 1
        parts = bytes([msg["part"], msg["parts"]]) + varint(len(msg["records"]))
        return head + low16s("lost", "tick", "events") + parts + bits.finish()
    if kind in (4, 5):
        records = b"".join(
            record["index"].to_bytes(4, "little") + b"".join(bytes.fromhex(part)[::-1] for part in record["motion"])
            for record in msg["records"]
        )
        return head + low16s("number", "tick", "events") + records
    if kind == 7:
        return head + low16s("next", "tick", "events") + bytes.fromhex(msg["checksum"])[::-1]
    if kind == 9:
        return head + low16s("last") + varint(msg["covered"]) + bytes([msg["row"]]) + bytes.fromhex(msg["symbol"])
    lost = b"".join(number.to_bytes(2, "little") for number in msg["lost"])
    return head + low16s("next", "abandoned") + bytes([msg["repair_symbols"]]) + varint(len(msg["lost"])) + lost


def times(a, b):
    product = 0
    for bit in range(8):
        if b >> bit & 1:
            product ^= a << bit
    for bit in range(15, 7, -1):
        if product >> bit & 1:
            product ^= 0x11D << bit - 8
    return product


@cache
def multiples(factor):
    """The products of a factor with each byte."""
    return bytes(times(factor, byte) for byte in range(256))


def inverse(byte):
    return multiples(byte).index(1)


def factor(row, number):
    return inverse((ROWS + row) ^ (number % ROWS))


def repair_symbol(row, packets):
    """The repair symbol of packets; each is a number and a datagram, the newest last."""
    last, _ = packets[-1]
    symbol, covered = bytearray(SYMBOL_MAX), 0
    for number, datagram in packets:
        frm = Bytes(datagram)
        kind, stream = read_head(frm)
        column = bytes([kind])
        frm.low16()
        covered |= 1 << last - number
        multiple = factor(row, number)
        for place, byte in enumerate(column + frm.rest()):
            symbol[place] ^= times(multiple, byte)
    msg = {"kind": 9, "stream": stream, "last": last % 65536, "covered": covered >> 1, "row": row}
    return encoded(msg | {"symbol": bytes(symbol).rstrip(b"\0").hex()})
