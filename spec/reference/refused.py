"""Datagrams to refuse: each breaks one rule of PROTOCOL 5, and is valid without that rule.

They are written by an encoder that does not know the rule, so lengths, codes and tails fit.
"""

import packets
from scripted import digits

AT_REST = {"predictor": 0, "parent": None, "position": [1, 2, 3], "largest": 3, "others": [0, 0, 0]}
MOVING = AT_REST | {"predictor": 1, "linear": [4, 5, 6], "angular": [7, 8, 9]}
ACCELERATED = {"predictor": 5, "parent": None, "acceleration": {"exponent": 1, "steps": [3, 0, 0]}} | {name: MOVING[name] for name in ("position", "largest", "others", "linear", "angular")}
STATE = digits([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
SAME = {"alias": 3, "body": None, "mode": "same", "age": 2, "position": [1, 0, 2], "turn": [0, 1, 0]}
WORLD = SAME | {"mode": "world", "predictor": 1, "parent_age": None, "velocity_exponent": 0, "linear": [1, 0, 0], "angular": [0, 0, 1]}
ATTACHED = SAME | {"mode": "attached", "parent": 7, "parent_age": 1}
RESTS = {"alias": 3, "body": None, "age": 2, "negated": 0, "steps": [9, 8, 7, 6, 5, 4, 1]}


def head(kind, first="number"):
    return {"stream": 5, "kind": kind, first: 4464, "tick": 300, "events": 12}


def state(*updates):
    return packets.encoded(head(1) | {"updates": list(updates)})


def keyframe(frame):
    return state({"alias": 3, "body": 7, "keyframe": frame})


def accelerated(exponent, steps):
    return {"exponent": exponent, "steps": steps}


def coded(write):
    """A state packet whose updates a function writes."""
    coder, update_coder = packets.RangeWriter(), packets.UpdateCoder()
    write(coder, update_coder)
    update_coder.end(coder)
    return packets.encoded(head(1) | {"updates": []})[:7] + coder.finish()


def longest(size):
    """A state packet of this many bytes."""
    updates = [{**SAME, "alias": alias, "position": [99999, 99999, 99999]} for alias in range(150)]
    while len(state(*updates)) > size - 8:
        updates.pop()
    last = ({**SAME, "alias": 200, "position": [x, y, 0]} for x in range(9) for y in (0, 1, 99, 9999, 1 << 20, 1 << 26))
    return next(data for data in (state(*updates, update) for update in last) if len(data) == size)


def keyframe_after_assignment(coder, update_coder, times):
    for code in (packets.ASSIGNMENT, packets.KEYFRAME):
        packets.write_code(packets.TABLES["modes"][0], code, coder)
    update_coder.model.write(0, 3, coder)
    for _ in range(times):
        coder.bits(7, packets.INDEX_BITS)
    packets.write_keyframe(AT_REST, coder)
    update_coder.went_on(packets.KEYFRAME)


def parent_again(coder, update_coder):
    update_coder.write(3, ATTACHED, coder)
    update_coder.parent = packets.INDICES  # so that the same parent is written as another one
    update_coder.write(0, ATTACHED, coder)


def refresh(part=0, parts=1, **record):
    record = {"index": 7, "alias": 3, "age": 2, "keyframe": AT_REST} | record
    return packets.encoded(head(3, "lost") | {"part": part, "parts": parts, "records": [record]})


def full(**record):
    return packets.encoded(head(5) | {"records": [{"index": 7, "motion": STATE} | record]})


def repair(row=7, covered=1, symbol="0203"):
    return packets.encoded({"stream": 5, "kind": 9, "last": 4464, "covered": covered, "row": row, "symbol": symbol})


def loss_report(repair_symbols=1, lost=3):
    return packets.encoded({"stream": 5, "kind": 6, "next": 9, "abandoned": 0, "repair_symbols": repair_symbols, "lost": list(range(lost))})


def changed(values, place, value):
    return [*values[:place], digits(value), *values[place + 1 :]]


def cases():
    """Requirement, what breaks it, and the bytes."""
    watermark = packets.encoded(head(2, "next"))
    yield "2.2-3", "a stream id in a longer form", b"\xf2\x85\x00" + watermark[1:]
    yield "5.8-2", "a stream id of 2^32", b"\xf2" + packets.varint((1 << 32) - 15) + watermark[1:]
    for kind in (8, 10, 13, 14, 15):
        yield "5.8-1", f"kind {kind}, else a watermark", bytes([0x50 | kind]) + watermark[1:]
    yield "5.8-5", "a datagram of 1151 bytes", longest(1151)
    yield "5.10-1", "a byte behind a watermark", watermark + b"\x01"
    yield "5.17-3", "an error scale of 0", b"\x5c\x00" + watermark[1:]
    for predictor in (6, 7):
        yield "5.5-2", f"predictor {predictor}", keyframe(MOVING | {"predictor": predictor})
    yield "5.5-5", "attached and uniform", keyframe(MOVING | {"parent": [9, 0]})
    yield "5.5-5", "attached, with a body state", keyframe({"predictor": 0, "parent": [9, 0], "body_state": STATE})
    yield "5.5-6", "a body state whose position is no number", keyframe({"predictor": 1, "parent": None, "body_state": ["7fc00000", *STATE[1:]]})
    yield "5.5-6", "a body state whose rotation has no length", keyframe({"predictor": 0, "parent": None, "body_state": changed(STATE, 6, 0.0)})
    yield "5.5-6", "a body state whose velocity is infinite", keyframe({"predictor": 1, "parent": None, "body_state": [*STATE[:12], "7f800000"]})
    for name, limit in (("position", packets.POSITION_LIMIT), ("linear", packets.VELOCITY_LIMIT), ("angular", packets.VELOCITY_LIMIT)):
        yield "5.5-6", f"a keyframe whose {name} is beyond its limit", keyframe(MOVING | {name: [0, -limit - 1, 0]})
    yield "5.5-6", "a packed rotation that no rotation has", keyframe(AT_REST | {"others": [524287, 524287, 524287]})
    yield "5.5-3", "a keyframe with an acceleration of exponent 13", keyframe(ACCELERATED | {"acceleration": accelerated(13, [1, 0, 0])})
    yield "5.5-3", "a keyframe with an acceleration of 1024 steps", keyframe(ACCELERATED | {"acceleration": accelerated(1, [0, 0, 1024])})
    yield "5.5-4", "constant acceleration with a body state", keyframe({"predictor": 5, "parent": None, "acceleration": accelerated(1, [3, 0, 0]), "body_state": STATE})
    for times in (1, 2):
        yield "5.6-2", f"an alias assigned before a keyframe, index written {times} times", coded(lambda coder, updates: keyframe_after_assignment(coder, updates, times))
    yield "5.6-4", "alias 2^20", state(SAME | {"alias": packets.INDICES})
    yield "5.9", "401 updates", state(*[{**SAME, "alias": alias, "age": 1, "position": [0, 0, 0], "turn": [0, 0, 0]} for alias in range(401)])
    yield "5.6-6", "an age beyond 2^30", state(SAME | {"age": packets.AGE_MAX + 1})
    yield "5.6-6", "an age before a rest correction beyond 2^30", state(RESTS | {"age": packets.AGE_MAX + 1})
    yield "5.6-15", "an age of a parent beyond 2^30, attached", state(ATTACHED | {"parent_age": packets.AGE_MAX + 1})
    yield "5.6-15", "an age of a parent beyond 2^30, in the world", state(WORLD | {"parent_age": packets.AGE_MAX + 1})
    yield "5.6-8", "velocity exponent 13", state(WORLD | {"velocity_exponent": 13})
    yield "5.6-10", "a position beyond 2^26", state(SAME | {"position": [0, packets.RESIDUAL_LIMIT + 1, 0]})
    yield "5.6-10", "a turn beyond 2^10", state(SAME | {"turn": [0, 0, -packets.TURN_LIMIT - 1]})
    for name in ("linear", "angular"):
        yield "5.6-10", f"a correction whose {name} velocity is beyond 2^19 with exponent 5", state(WORLD | {"velocity_exponent": 5, name: [0, (1 << 19) + 1, 0]})
    yield "5.6-12", "a step of 32 bits", state(RESTS | {"steps": [1 << 31, 0, 0, 0, 0, 0, 0]})
    yield "5.6-14", "the same parent written as another", coded(parent_again)
    yield "5.6-17", "an acceleration of exponent 13", state(WORLD | {"predictor": 5, "acceleration": accelerated(13, [1, 0, 0])})
    yield "5.6-17", "an acceleration of 1024 steps", state(WORLD | {"predictor": 5, "acceleration": accelerated(1, [0, -1024, 0])})
    yield "5.11", "part 2 of 2, counted from 0", refresh(part=2, parts=2)
    yield "5.11", "65 parts", refresh(parts=65)
    yield "5.11-1", "a record with an age beyond 2^30", refresh(age=packets.AGE_MAX + 1)
    yield "5.11-2", "a record of index 2^20", refresh(index=packets.INDICES)
    yield "5.11-3", "a record of alias 2^20", refresh(alias=packets.INDICES)
    yield "5.1-2", "a byte behind a refresh", refresh() + b"\x00"
    yield "5.12-2", "a full packet whose velocity is no number", full(motion=[*STATE[:12], "7fc00000"])
    yield "5.12-1", "a full packet of index 2^20", full(index=packets.INDICES)
    yield "5.13-1", "33 repair symbols requested", loss_report(repair_symbols=33)
    yield "5.13-1", "65 numbers requested", loss_report(lost=65)
    yield "5.13-1", "a byte behind a loss report", loss_report() + b"\x00"
    yield "5.16", "a repair symbol of row 128", repair(row=128)
    yield "5.16", "a repair symbol over 33 numbers", repair(covered=1 << 31)
    yield "5.16", "a repair symbol of 1137 bytes", repair(symbol="01" * 1137)
    yield "5.16-4", "a repair symbol that ends in a zero", repair(symbol="020300")
    yield "5.14-1", "a byte behind a checksum", packets.encoded(head(7, "next") | {"checksum": "0102030405060708"}) + b"\x00"


def lines():
    return [{"name": name, "breaks": requirement, "bytes": data.hex()} for requirement, name, data in cases()]
