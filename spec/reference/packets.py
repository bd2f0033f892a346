"""Section 5 of PROTOCOL in Python: datagrams taken apart and put together, from the document alone.

For reading beside the document, not for speed. A datagram is a dict as the vectors have it.
"""

import json
import struct
from functools import cache
from pathlib import Path

import reckoning

TABLES = json.loads((Path(__file__).resolve().parent.parent / "tables" / "packets.json").read_text(encoding="utf-8"))

INDEX_BITS, INDICES = 20, 1 << 20
AGE_MAX = 1 << 30
UPDATES_MAX, RECORDS_MAX, LOST_MAX, PARTS_MAX, SUMS_MAX = 400, 9200, 64, 64, 128
SPAN, ROWS, COLUMN_MAX = 32, 128, 1136
POSITION_LIMIT, VELOCITY_LIMIT, RESIDUAL_LIMIT, TURN_LIMIT = 1 << 30, 1 << 24, 1 << 26, 1 << 10
COARSENESS_LIMIT = 12
SETTLED_AGE, COARSENESS, LENGTH, DOUBLINGS, PUSH = 7, 384, 388, 393, 394  # contexts
GOLOMB_MAX = 3 << 30
ALPHABET_BITS, ESCAPE = 12, 17
END, SEATING, SETTLED, WHOLE, HELD = 17, 16, 13, 12, 11
WORD = 1 << 32


class Malformed(Exception):
    """The bytes are refused; the argument is a word for why."""


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
    if context >= PUSH:
        return 3
    return 1 if 8 <= context < 128 else 2 if 128 <= context < 344 else 3 if 344 <= context < COARSENESS else 0


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


def age_class(age):
    return sum(age > end for end in (1, 2, 4, 10, 30))


def follows(part, total):
    return 0 if total == 0 else 1 if total <= part else 2 if total <= 3 * part else 3


class Walk:
    """The contexts of a correction's numbers, in order."""

    def __init__(self, kind, age):
        self.kind, self.age = kind, age_class(age)
        self.triple = self.part = self.total = self.largest = 0

    def context(self):
        slot = 1 + follows(self.part, self.total) if self.part else 0
        if self.triple == 0:
            return 8 + (6 * self.kind + self.age) * 5 + slot
        if self.triple == 1:
            n = self.largest
            first = 4 if n == 0 else 5 + ilog2(n) if n < 8 else 8
            return 128 + (6 * self.kind + self.age) * 9 + (slot - 1 if self.part else first)
        late = int(self.age >= 2)
        return 344 + (4 * (self.kind // 2) + 2 * late + self.triple - 2) * 5 + slot

    def step(self, size):
        if self.triple == 0:
            self.largest = max(self.largest, size)
        self.total += size
        self.part += 1
        if self.part == 3:
            self.triple, self.part, self.total = self.triple + 1, 0, 0


TRIPLES = ("position", "turn", "linear", "angular")
LIMITS = (RESIDUAL_LIMIT, TURN_LIMIT, VELOCITY_LIMIT, VELOCITY_LIMIT)
PUSHED = 5  # the law
# By form: the course, the law, and whether velocities are said.
FORMS = [
    ("same", None, False),
    ("same", None, True),
    ("world", 0, False),
    *[("world", law, moved) for law in (1, 2, 3, 4) for moved in (False, True)],
    ("held", None, False),
    None,  # a whole track
    None,  # settled
    ("world", PUSHED, False),
    ("world", PUSHED, True),
]


def push_context(part, total):
    return PUSH + (1 + follows(part, total) if part else 0)


def coarseness_context(kind, age):
    return COARSENESS + 2 * (kind // 2) + int(age_class(age) >= 2)


def length_context(place, lengths):
    """Of a step of a settling: its context, and the length that its own is measured against."""
    part, fixed = ((0, 14), (1, None), (1, None), (2, 19), (3, None), (3, None), (4, 1))[place]
    return LENGTH + part, lengths[place - 1] if fixed is None else fixed


def kind_of(course, moved):
    return 2 * (course != "same") + moved


class Tongue:
    def __init__(self):
        self.model, self.row, self.begun, self.carrier = Model(), 0, 0, None

    def went_on(self, form):
        self.begun, self.row = 1, {0: 1, 1: 2}.get(form, 3)

    def write(self, gap, update, to):
        modes = TABLES["modes"][self.row]
        if "whole" in update:
            write_code(modes, WHOLE, to)
            self.model.write(self.begun, gap, to)
            to.bits(update["body"], INDEX_BITS)
            write_whole(update["whole"], to)
            return self.went_on(WHOLE)
        moved = "linear" in update
        settled = "negated" in update
        form = SETTLED if settled else FORMS.index((update["course"], update.get("law"), moved))
        if update["body"] is not None:
            write_code(modes, SEATING, to)
        write_code(modes, form, to)
        self.model.write(self.begun, gap, to)
        if update["body"] is not None:
            to.bits(update["body"], INDEX_BITS)
        if settled:
            self.write_settled(update, to)
            return self.went_on(SETTLED)
        kind = kind_of(update["course"], moved)
        self.model.write(2 + kind, update["age"] - 1, to)
        self.write_carrier(update, to)
        if update.get("law") == PUSHED:
            self.write_push(update["push"], to)
        if moved:
            self.model.write(coarseness_context(kind, update["age"]), update["coarseness"], to)
        walk = Walk(kind, update["age"])
        for name in TRIPLES[: 4 if moved else 2]:
            for number in update[name]:
                self.model.write(walk.context(), abs(number), to)
                if number:
                    to.bits(int(number < 0), 1)
                walk.step(abs(number))
        self.went_on(form)

    def write_push(self, push, to):
        self.model.write(DOUBLINGS, push["doublings"], to)
        total = 0
        for part, number in enumerate(push["steps"]):
            self.model.write(push_context(part, total), abs(number), to)
            if number:
                to.bits(int(number < 0), 1)
            total += abs(number)

    def read_push(self, frm):
        push, total = {"doublings": self.model.read(DOUBLINGS, frm), "steps": []}, 0
        for part in range(3):
            size = self.model.read(push_context(part, total), frm)
            refuse_if(size > reckoning.PUSH_LIMIT, "OutOfRange")
            push["steps"].append(-size if size and frm.bits(1) else size)
            total += size
        refuse_if(push["doublings"] > reckoning.DOUBLINGS_LIMIT, "OutOfRange")
        return push

    def write_settled(self, update, to):
        self.model.write(SETTLED_AGE, update["age"] - 1, to)
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

    def read_settled(self, update, frm):
        update["age"] = self.read_age(SETTLED_AGE, frm)
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

    def write_carrier(self, update, to):
        if update["course"] == "same":
            return
        if update["course"] == "world":
            to.bits(int(update["carrier_age"] is not None), 1)
        else:
            again = self.carrier == update["carrier"]
            if self.carrier is not None:
                to.bits(int(again), 1)
            if not again:
                to.bits(update["carrier"], INDEX_BITS)
            self.carrier = update["carrier"]
        if update["carrier_age"] is not None:
            self.model.write(6, update["carrier_age"], to)

    def end(self, to):
        write_code(TABLES["modes"][self.row], END, to)

    def read(self, frm):
        """The gap and what is said, or None at the end."""
        modes = TABLES["modes"][self.row]
        form, update = read_code(modes, frm), {"body": None}
        if form == END:
            return None
        seating = form == SEATING
        if seating:
            form = read_code(modes, frm)
            refuse_if(form in (SEATING, WHOLE, END), "NotCanonical")
        gap = self.model.read(self.begun, frm)
        if seating:
            update["body"] = frm.bits(INDEX_BITS)
        if form == WHOLE:
            update["body"] = frm.bits(INDEX_BITS)
            update["whole"] = read_whole(frm)
        elif form == SETTLED:
            self.read_settled(update, frm)
        else:
            self.read_correction(form, update, frm)
        self.went_on(form)
        return gap, update

    def read_correction(self, form, update, frm):
        course, law, moved = FORMS[form]
        kind = kind_of(course, moved)
        age = self.read_age(2 + kind, frm)
        update |= {"course": course, "age": age}
        if course == "world":
            update["law"] = law
            update["carrier_age"] = self.read_carrier_age(frm) if frm.bits(1) else None
            if law == PUSHED:
                update["push"] = self.read_push(frm)
        elif course == "held":
            if self.carrier is None or not frm.bits(1):
                carrier = frm.bits(INDEX_BITS)
                refuse_if(carrier == self.carrier, "NotCanonical")
                self.carrier = carrier
            update["carrier"] = self.carrier
            update["carrier_age"] = self.read_carrier_age(frm)
        limits = LIMITS
        if moved:
            coarseness = update["coarseness"] = self.model.read(coarseness_context(kind, age), frm)
            limits = LIMITS[:2] + (VELOCITY_LIMIT >> min(coarseness, COARSENESS_LIMIT),) * 2
        walk = Walk(kind, age)
        for name in TRIPLES[: 4 if moved else 2]:
            update[name] = []
            for _ in range(3):
                size = self.model.read(walk.context(), frm)
                refuse_if(size >= 1 << 31, "OutOfRange")
                update[name].append(-size if size and frm.bits(1) else size)
                walk.step(size)
        refuse_if(moved and coarseness > COARSENESS_LIMIT, "OutOfRange")
        for name, limit in zip(TRIPLES, limits):
            refuse_if(any(abs(number) > limit for number in update.get(name, ())), "OutOfRange")

    def read_carrier_age(self, frm):
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


# 5.5 Whole tracks


def write_whole(whole, to):
    to.bits(whole["law"], 3)
    to.bits(int(whole["carrier"] is not None), 1)
    if whole["carrier"] is not None:
        to.bits(whole["carrier"][0], INDEX_BITS)
        to.bits(whole["carrier"][1], 16)
    if whole["law"] == PUSHED:
        to.bits(whole["push"]["doublings"], 4)
        write_signed(whole["push"]["steps"], 6, to)
    to.bits(int("verbatim" in whole), 1)
    if "verbatim" in whole:
        for part in whole["verbatim"][: 13 if whole["law"] else 7]:
            to.bits(int(part, 16), 32)
        return
    write_signed(whole["position"], 14, to)
    to.bits(whole["largest"], 2)
    for other in whole["others"]:
        to.bits(other + 524288, 20)
    if whole["law"]:
        write_signed(whole["linear"], 6, to)
        write_signed(whole["angular"], 6, to)


def read_whole(frm):
    law = frm.bits(3)
    refuse_if(law > PUSHED, "UnknownCode")
    carrier = [frm.bits(INDEX_BITS), frm.bits(16)] if frm.bits(1) else None
    whole = {"law": law, "carrier": carrier}
    if law == PUSHED:
        push = whole["push"] = {"doublings": frm.bits(4), "steps": read_signed(6, frm)}
        refuse_if(reckoning.Push.of(push["steps"], push["doublings"]) is None, "OutOfRange")
    if frm.bits(1):
        parts = [frm.bits(32) for _ in range(13 if law else 7)]
        parts += [0] * (13 - len(parts))
        motion = [struct.unpack(">f", part.to_bytes(4, "big"))[0] for part in parts]
        refuse_if(reckoning.verbatim_motion(motion) is None, "NotFinite")
        whole["verbatim"] = [f"{part:08x}" for part in parts]
    else:
        whole["position"] = read_signed(14, frm)
        whole["largest"] = frm.bits(2)
        whole["others"] = [frm.bits(20) - 524288 for _ in range(3)]
        refuse_if(not reckoning.is_packed(whole["largest"], tuple(whole["others"])), "NotCanonical")
        whole["linear"] = read_signed(6, frm) if law else [0, 0, 0]
        whole["angular"] = read_signed(6, frm) if law else [0, 0, 0]
        for name, limit in (("position", POSITION_LIMIT), ("linear", VELOCITY_LIMIT), ("angular", VELOCITY_LIMIT)):
            refuse_if(any(abs(number) > limit for number in whole[name]), "OutOfRange")
    refuse_if(carrier is not None and (law or "verbatim" in whole), "OutOfRange")
    refuse_if(law == PUSHED and "verbatim" in whole, "OutOfRange")
    return whole


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


IN_ARREARS = (11, 12)
LARGE = 15


def eighths(code):
    """The factor that an excess stands for, in eighths; none if it is not bounded [5.17]."""
    refuse_if(code == 0, "NotCanonical")
    return None if code == 255 else (8 + code % 8) << code // 8


def excess_of(factor):
    return 255 if factor is None else next(code for code in range(1, 255) if eighths(code) == factor)


def read_head(frm):
    """Kind and stream [5.8]."""
    first = frm.u8()
    kind, stream = first & 15, first >> 4
    refuse_if(kind > 9 and kind not in IN_ARREARS, "UnknownCode")
    if stream == LARGE:
        stream += frm.varint(WORD - 1)
        refuse_if(stream >= WORD, "OutOfRange")
    return kind, stream


def head_of(kind, stream):
    small = min(stream, LARGE)
    return bytes([kind | small << 4]) + (varint(stream - LARGE) if small == LARGE else b"")


def decoded(datagram):
    frm = Bytes(datagram)
    kind, stream = read_head(frm)
    said = {"stream": stream, "kind": kind}
    if kind in IN_ARREARS:
        said["excess_eighths"] = eighths(frm.u8())
    if kind in (0, 1, 11):
        said |= {name: frm.low16() for name in ("number", "tick", "notices")}
        coder, tongue, seat, said["updates"] = RangeReader(frm.rest()), Tongue(), 0, []
        while (read := tongue.read(coder)) is not None:
            refuse_if(len(said["updates"]) == UPDATES_MAX, "TooLong")
            gap, update = read
            seat += gap
            refuse_if(seat >= INDICES, "OutOfRange")
            said["updates"].append({"seat": seat} | update)
            seat += 1
        coder.finish()
    elif kind in (2, 12):
        said |= {name: frm.low16() for name in ("next", "tick", "notices")}
        frm.finish()
    elif kind == 3:
        said |= {name: frm.low16() for name in ("lost", "tick", "notices")}
        said |= {"part": frm.u8(), "parts": frm.u8()}
        refuse_if(said["part"] >= said["parts"] or said["parts"] > PARTS_MAX, "OutOfRange")
        read_records(said, frm)
    elif kind in (4, 5):
        said |= {name: frm.low16() for name in ("number", "tick", "notices")}
        read_full(said, frm)
    elif kind == 7:
        said |= {name: frm.low16() for name in ("next", "tick", "notices")}
        said |= {"first": frm.varint(INDICES - 1), "stride": frm.varint(INDICES)}
        refuse_if(said["stride"] == 0, "OutOfRange")
        said["sums"] = [frm.raw(8)[::-1].hex() for _ in range(frm.varint(SUMS_MAX))]
        frm.finish()
    elif kind == 8:
        said |= {"first": frm.varint(INDICES - 1), "stride": frm.varint(INDICES)}
        refuse_if(said["stride"] == 0, "OutOfRange")
        frm.finish()
    elif kind == 6:
        said |= {"next": frm.low16(), "gone": frm.low16(), "parities": frm.u8()}
        refuse_if(said["parities"] > SPAN, "OutOfRange")
        count = frm.varint(LOST_MAX, "TooLong")
        said["lost"] = [frm.low16() for _ in range(count)]
        frm.finish()
    elif kind == 9:
        said |= {"last": frm.low16(), "covered": frm.varint(WORD - 1), "row": frm.u8()}
        refuse_if(said["covered"] >= 1 << SPAN - 1 or said["row"] >= ROWS, "OutOfRange")
        sums = frm.rest()
        refuse_if(len(sums) > COLUMN_MAX, "TooLong")
        refuse_if(sums.endswith(b"\0"), "NotCanonical")
        said["sums"] = sums.hex()
    return said


def read_full(said, frm):
    said["records"] = []
    while frm.at < len(frm.data):
        record = {"index": int.from_bytes(frm.raw(4), "little")}
        refuse_if(record["index"] >= INDICES, "OutOfRange")
        record["motion"] = [frm.raw(4)[::-1].hex() for _ in range(13)]
        numbers = [struct.unpack(">f", bytes.fromhex(part))[0] for part in record["motion"]]
        refuse_if(reckoning.verbatim_motion(numbers) is None, "NotFinite")
        said["records"].append(record)


def read_records(said, frm):
    count = frm.varint(RECORDS_MAX)
    bits, index, said["records"] = BitReader(frm.rest()), 0, []
    for _ in range(count):
        index += read_golomb(3, bits)
        seat, age = read_golomb(5, bits) - 1, read_golomb(4, bits)
        refuse_if(index >= INDICES or seat >= INDICES or age > AGE_MAX, "OutOfRange")
        record = {"index": index, "seat": seat if seat >= 0 else None, "age": age}
        said["records"].append(record | {"whole": read_whole(bits)})
        index += 1
    bits.finish()


def encoded(said):
    def low16s(*names):
        return b"".join(said[name].to_bytes(2, "little") for name in names)

    kind = said["kind"]
    head = head_of(kind, said["stream"])
    if kind in IN_ARREARS:
        head += bytes([excess_of(said["excess_eighths"])])
    if kind in (0, 1, 11):
        coder, tongue, seat = RangeWriter(), Tongue(), 0
        for update in said["updates"]:
            tongue.write(update["seat"] - seat, update, coder)
            seat = update["seat"] + 1
        tongue.end(coder)
        return head + low16s("number", "tick", "notices") + coder.finish()
    if kind in (2, 12):
        return head + low16s("next", "tick", "notices")
    if kind == 3:
        bits, index = BitWriter(), 0
        for record in said["records"]:
            write_golomb(record["index"] - index, 3, bits)
            write_golomb(0 if record["seat"] is None else record["seat"] + 1, 5, bits)
            write_golomb(record["age"], 4, bits)
            write_whole(record["whole"], bits)
            index = record["index"] + 1
        parts = bytes([said["part"], said["parts"]]) + varint(len(said["records"]))
        return head + low16s("lost", "tick", "notices") + parts + bits.finish()
    if kind in (4, 5):
        records = b"".join(
            record["index"].to_bytes(4, "little") + b"".join(bytes.fromhex(part)[::-1] for part in record["motion"])
            for record in said["records"]
        )
        return head + low16s("number", "tick", "notices") + records
    if kind in (7, 8):
        ranges = varint(said["first"]) + varint(said["stride"])
        if kind == 8:
            return head + ranges
        sums = b"".join(bytes.fromhex(part)[::-1] for part in said["sums"])
        return head + low16s("next", "tick", "notices") + ranges + varint(len(said["sums"])) + sums
    if kind == 9:
        return head + low16s("last") + varint(said["covered"]) + bytes([said["row"]]) + bytes.fromhex(said["sums"])
    lost = b"".join(number.to_bytes(2, "little") for number in said["lost"])
    return head + low16s("next", "gone") + bytes([said["parities"]]) + varint(len(said["lost"])) + lost


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
    """Those of each byte."""
    return bytes(times(factor, byte) for byte in range(256))


def inverse(byte):
    return multiples(byte).index(1)


def factor(row, number):
    return inverse((ROWS + row) ^ (number % ROWS))


def parity(row, packets):
    """The parity of packets, each a number and a datagram, the newest last."""
    last, _ = packets[-1]
    sums, covered = bytearray(COLUMN_MAX), 0
    for number, datagram in packets:
        frm = Bytes(datagram)
        kind, stream = read_head(frm)
        column = bytes([kind])
        frm.low16()
        covered |= 1 << last - number
        multiple = factor(row, number)
        for place, byte in enumerate(column + frm.rest()):
            sums[place] ^= times(multiple, byte)
    said = {"kind": 9, "stream": stream, "last": last % 65536, "covered": covered >> 1, "row": row}
    return encoded(said | {"sums": bytes(sums).rstrip(b"\0").hex()})
