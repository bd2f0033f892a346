"""Scripted streams of single rules: each is the smallest that shows whether a subscriber keeps its rule.

make_streams.py has the longer ones, in which rules meet. Each function cites the clauses that its streams are about.
"""

import packets
from scripted import STILL, SURFACE, Authority, Stream, digits, gravity_changed, placed, removed

BUDGET = {"is": "within a budget", "rate": 2000, "burst": 1200, "choice": SURFACE}


def started(name, balls, *events, **terms):
    """A stream of balls whose snapshot has arrived."""
    s = Stream(name, [*[placed(index, origin=terms.get("tick", 0)) for index in range(balls)], *events], **terms)
    s.join()
    return s


def all_corrected(s, tick, count):
    """Each of the first bodies takes the alias that is its index."""
    s.get(s.packet(tick, *[s.corrected(index, tick) for index in range(count)]), quiet=True)


# Ticks


def newest_ticks():
    """5.7-1, 6.7-9"""
    s = started("a tick at equal distance from that of a packet that does not end it", 1, tick=40000)
    s.get(s.packet(40001, s.corrected(0, 40001), kind=0), s.watermark(40001 + 32768))
    yield s
    s = started("3600 ticks after a packet that does not end its tick", 1)
    s.get(s.packet(5, s.corrected(0, 5), kind=0), s.watermark(3605))
    yield s
    s = started("a body placed far ahead", 1)
    s.control(s.event(placed(1, origin=3000)))
    s.get(s.watermark(3700))
    yield s
    s = started("a packet 3600 ticks after a checksum", 1)
    checksum = s.checksum(10)
    s.tracks.receive_datagram(checksum)
    s.get(checksum, s.packet(3610, s.keyframe(0, 1)))
    yield s


def published_ticks():
    """6.4-4, 6.8-4"""
    s = started("a snapshot between published ticks", 1, tick=4, publish_interval=3)
    s.get(s.packet(6, s.corrected(0, 6), kind=0), s.packet(6), s.watermark(9))
    yield s
    s = started("a packet between published ticks", 1, publish_interval=3)
    s.get(s.packet(8, s.corrected(0, 8), kind=0))
    yield s


def snapshot_packets():
    """6.6-4, 6.11-2"""
    s = started("a packet of the snapshot arrives first", 1, tick=10, next=1000)
    s.get(s.packet(10, s.corrected(0, 10, age=10) | {"alias": 9}, checked=False, number=999), s.watermark(11))
    yield s


def snapshot_waits():
    """6.5-2, 6.5-3, 6.8-2"""
    s = started("two packets that wait for two scene events", 2)
    first = s.event(gravity_changed(1, 0.0, 1.0, 0.0))
    one = s.packet(1, s.corrected(0, 1))
    second = s.event(gravity_changed(2, 0.0, 2.0, 0.0))
    s.get(one, s.packet(2, s.corrected(1, 2)))
    s.control(first)
    s.control(second)
    yield s
    s = Stream("a packet that still waits when the snapshot ends", [placed(0, origin=50)], tick=50)
    s.join(upto=0)
    new = s.event(gravity_changed(51, 0.0, 1.0, 0.0))
    s.get(s.packet(51, s.corrected(0, 51)))
    s.end_snapshot()
    s.control(new)
    yield s
    s = Stream("a packet before Joined", [placed(0)])
    s.get(s.packet(1, s.corrected(0, 1)))
    s.join()
    s.get(s.watermark(1))
    s.settle(2)
    yield s


# Scene events


def unknown_events():
    """3.5-6, 4.8-3"""
    s = started("scene events of unknown kinds count, but for those of the snapshot", 2, {"is": 0x8A, "rest": "01"})
    first, second = s.event({"is": 0x8A, "rest": "0102ff"}), s.event({"is": 0xC1, "rest": ""})
    s.get(s.packet(1, s.corrected(0, 1)))
    s.control(first)
    s.control(second)
    s.get(s.packet(2, s.corrected(1, 2)))
    third = s.event({"is": 0xFF, "rest": "00"})
    s.get(s.packet(3, s.corrected(0, 3)))
    s.control(third)
    s.get(s.checksum(4))
    yield s


def fixed_to(id_, first, second):
    """`JointAdded` of a fixed joint."""
    ends = {"first": {"index": first, "generation": 0}, "second": {"index": second, "generation": 0}}
    anchors = {"first anchor": digits(STILL), "second anchor": digits(STILL)}
    return {"is": "JointAdded", "id": id_, "joint": {"flags": 0} | ends | anchors}


def joints():
    """4.6-2, 4.6-8"""
    s = Stream("joints go with their bodies, and with nothing else", [*[placed(index) for index in range(4)], fixed_to(1, 0, 1), fixed_to(2, 1, 2), fixed_to(5, 2, 3)])
    s.joints = True
    s.join()
    # A body that is placed again keeps its joints.
    s.control(s.event(placed(2, shape=1, origin=1)))
    s.control(s.event(removed(1)))
    # In place of the earlier joint 5: that one does not go with body 3.
    s.control(s.event(fixed_to(5, 0, 2)))
    s.control(s.event(removed(3)))
    s.control(s.event(fixed_to(1, 2, 0)))
    s.control(s.event({"is": "JointRemoved", "id": 5}))
    s.control(s.event(removed(2)))
    yield s


# Reading


def unreadable_updates():
    """6.2-2, 6.6-10, and lines S71 to S80"""
    s = started("a rest correction without a rotation", 1)
    all_corrected(s, 1, 1)
    s.get(s.packet(2, s.rests(0, 2) | {"steps": [0, 0, 0, 0, 0, 0, 1 << 24]}, checked=False))
    s.settle(3)
    yield s
    s = started("a detachment from a parent that was removed", 3)
    all_corrected(s, 1, 3)
    s.get(s.packet(2, s.corrected(1, 2, "attached", parent=0)), quiet=True)
    s.control(s.event(removed(0)))
    lost = s.packet(3, s.corrected(2, 3))
    s.get(s.packet(4, s.corrected(1, 4, "world", 1, parent_age=2), checked=False), lost)
    s.settle(5)
    yield s
    s = started("an attachment with a wrong age and no parent", 1)
    all_corrected(s, 1, 1)
    s.get(s.packet(2, s.corrected(0, 2, "attached", parent=40, parent_age=1) | {"age": 9}, checked=False))
    s.settle(3)
    yield s
    s = started("a packet with an unknown alias and a wrong age", 3)
    s.get(s.packet(1, *[s.corrected(index, 1, alias=1 + index) for index in range(3)]), quiet=True)
    lost = s.packet(2, s.corrected(2, 2))
    unknown = s.corrected(0, 3) | {"alias": 0}
    s.get(s.packet(3, unknown, s.corrected(1, 3) | {"age": 9}, checked=False), *s.refresh(2, 4, bodies=[0, 1]), lost)
    yield s


def replaced_tracks():
    """6.1-1, 6.7-7, 6.8-3"""
    s = started("a refresh with another track of an origin that is here", 2, tick=5)
    s.packet(6, s.corrected(1, 6))
    other = packets.decoded(s.refresh(0, 6, bodies=[0, 1])[0])
    other["records"][0]["keyframe"]["body_state"][0] = "40a00000"
    s.get(s.watermark(6), packets.encoded(other), s.checksum(6))
    yield s
    s = started("a body placed again", 1)
    s.get(s.packet(1, s.corrected(0, 1)), s.watermark(4))
    s.control(s.event(placed(0, origin=8)))
    s.get(s.watermark(9))
    yield s
    s = started("two records of one body", 1, choice={"is": "full"})
    s.get(s.full(1, 0, 0))
    yield s


def named_refreshes():
    """6.7-8, 6.15-5"""
    s = started("a refresh in fewer parts after a scene event", 3)
    s.packet(1, *[s.corrected(index, 1) for index in range(3)])
    three = s.refresh(0, 1, 3)
    new = s.event(gravity_changed(2, 0.0, 1.0, 0.0))
    two = s.refresh(0, 1, 2)
    s.control(new)
    s.get(s.watermark(1), quiet=True)
    s.get(three[0], *two)
    yield s
    s = started("a packet rebuilt after its refresh", 1)
    all_corrected(s, 1, 1)
    s.packet(2, s.corrected(0, 2))
    s.get(s.watermark(2), *s.refresh(1, 3), s.repair(0, 1))
    yield s
    s = started("two repair symbols over a packet that was refreshed", 2)
    all_corrected(s, 1, 2)
    s.packet(2, s.corrected(0, 2))
    s.packet(3, s.corrected(1, 3))
    s.get(s.repair(0, 1, 2), s.watermark(3), *s.refresh(1, 4), s.repair(1, 1, 2))
    yield s


# A second snapshot


def joined_again(first, events, **terms):
    """A further stream of the member of the first one: the second `Joined`, its snapshot and what follows."""
    s = Stream(first.name, events, **terms)
    s.member, s.recorded = first.member, first.recorded
    return s


def second_snapshots():
    """4.8-5, 4.8-12, 5.8-8, 6.5-3"""
    events = [placed(2, origin=9, track="ballistic"), placed(3, origin=7, alias=2)]
    old = started("a second Joined after touch is lost", 3, gravity_changed(0, 0.0, 1.0, 0.0))
    all_corrected(old, 1, 3)
    old.get(old.checksum(2, off=1))
    s = joined_again(old, events, tick=9, next=40, count=7)
    s.join(upto=1)
    s.get(s.packet(10, s.corrected(3, 10)), old.packet(11, old.keyframe(0, 1), number=39))
    s.end_snapshot()
    s.get(s.packet(11, s.corrected(2, 11)))
    # Alias 2 had a body in the first copy only.
    s.get(s.packet(12, s.corrected(2, 12) | {"alias": 2}, checked=False), *s.refresh(42, 12, bodies=[2]), s.checksum(13))
    yield s
    old = started("a second Joined with another stream", 1)
    all_corrected(old, 1, 1)
    s = joined_again(old, events, tick=9, next=40, count=7, stream=6, choice=SURFACE | {"micrometres": 20000})
    s.join()
    s.get(s.packet(10, s.corrected(3, 10), s.corrected(2, 10)), old.watermark(12), s.checksum(11))
    yield s


# Aliases


def late_assignments():
    """6.13-7, 6.13-8, and lines S106, S118 and S119"""
    # Body 0 has alias 7 until it rests, then body 1. The assignment to body 1 comes late, that to body 0 later.
    s = started("an assignment older than one to a body with a newer track", 2)
    all_corrected(s, 1, 2)
    first, rests = s.packet(2, s.corrected(0, 2, alias=7)), s.packet(3, s.rests(0, 3))
    second = s.packet(4, s.corrected(1, 4, alias=7))
    s.get(s.packet(5, s.keyframe(1, 1, alias=8)), second, first, rests)
    s.settle(6)
    yield s
    # Body 1 has alias 1 until it rests, then body 2. That body 1 has another alias by now does not matter.
    s = started("an assignment of an alias whose body has another one since", 3)
    all_corrected(s, 1, 2)
    s.get(s.packet(2, s.rests(1, 2)), quiet=True)
    takes, uses = s.packet(3, s.corrected(2, 3, alias=1)), s.packet(4, s.corrected(2, 4))
    s.get(s.packet(5, s.corrected(1, 5, alias=9)), takes, uses)
    yield s
    # The same, but a refresh says that body 1 has no alias.
    s = started("an assignment of an alias that a later refresh ended", 3)
    all_corrected(s, 1, 2)
    s.packet(2, s.rests(1, 2))
    takes, uses = s.packet(3, s.corrected(2, 3, alias=1)), s.packet(4, s.corrected(2, 4))
    s.get(s.packet(5, s.corrected(0, 5)), *s.refresh(1, 5), takes, uses)
    yield s
    s = started("a refresh that ends an alias of its own tick", 3)
    all_corrected(s, 1, 2)
    s.packet(2, s.corrected(1, 2))
    s.get(s.packet(3, s.keyframe(1, 0, state=True, alias=9)), *s.refresh(1, 3))
    s.packet(4, s.corrected(2, 4, alias=9))
    s.get(s.packet(5, s.corrected(2, 5)))
    s.settle(6)
    yield s


# Budgets


def spans():
    """6.16-9, 6.16-12"""
    s = started("spans that begin before a packet that does not end its tick", 2, choice=BUDGET, tick=10)
    s.get(s.packet(12, s.corrected(0, 12), kind=11, scale=30), quiet=True)
    s.get(s.packet(15, s.corrected(1, 15), kind=0), s.watermark(16, kind=12, scale=12))
    s.get(s.packet(18, s.corrected(0, 18), kind=0), s.packet(18, s.corrected(1, 18), kind=11, scale=20))
    s.packet(20, s.corrected(0, 20), kind=11, scale=9)
    s.get(s.packet(22, s.corrected(1, 22), kind=0), s.packet(22, kind=11, scale=10))
    yield s


# Repair symbols


def lost_pairs(s):
    """Packets 1 to 20 are lost; 16 symbols that lack two of them each are kept, the first over packets 1 and 2."""
    all_corrected(s, 1, 2)
    lost = [s.packet(2 + step, s.corrected(step % 2, 2 + step)) for step in range(20)]
    s.get(s.repair(0, 1, 2), *[s.repair(1 + step, 3 + step, 4 + step) for step in range(15)], quiet=True)
    return lost


def seventeenth_symbols():
    """6.15-3"""
    s = started("a repair symbol that comes as the first one is dropped", 2)
    lost_pairs(s)
    s.get(s.repair(40, 1, 2))
    yield s
    s = started("a repair symbol that lacks one packet, beyond the limit", 2)
    lost = lost_pairs(s)
    s.get(s.repair(40, 20), lost[1])
    yield s


def made(number, row, source_symbol):
    """A repair symbol over one packet, of which this is the source symbol."""
    symbol = source_symbol.translate(packets.multiples(packets.factor(row, number)))
    return packets.encoded({"stream": 5, "kind": 9, "last": number & 0xFFFF, "covered": 0, "row": row, "symbol": symbol.hex()})


def wrong(symbol, row, number, by=3):
    """A repair symbol that changes the kind of one of its packets."""
    symbol = bytearray(symbol)
    symbol[5] ^= packets.times(packets.factor(row, number), by)  # the first byte behind last, covered and row
    return bytes(symbol)


def after_wrong_symbols():
    """6.15-6, 6.15-7"""
    s = started("a packet lost before a wrong repair symbol", 2)
    all_corrected(s, 1, 2)
    s.packet(2, s.corrected(0, 2))
    s.packet(3, s.corrected(1, 3))
    s.get(s.packet(4, s.keyframe(0, 1)), wrong(s.repair(0, 1), 0, 1), s.repair(1, 2))
    yield s
    s = started("a good packet that would be rebuilt behind a malformed one", 2)
    all_corrected(s, 1, 2)
    s.packet(2, s.corrected(0, 2))
    s.packet(3, s.corrected(1, 3))
    s.get(*[wrong(s.repair(row, 1, 2), row, 1) for row in (0, 1)], s.watermark(3))
    yield s
    s = started("a rebuilt watermark", 1, count=257)
    all_corrected(s, 1, 1)
    s.packet(2)
    s.get(made(1, 0, bytes([2, 9, 0, 1, 1])), s.repair(1, 1), s.watermark(2))
    yield s
    s = started("a repair symbol over a malformed packet and a later one", 2)
    all_corrected(s, 1, 2)
    s.packet(2, s.corrected(0, 2))
    s.get(s.packet(3, s.corrected(1, 3)), wrong(s.repair(0, 1), 0, 1), quiet=True)
    s.packet(4, s.corrected(1, 4))
    s.get(s.repair(1, 1, 3), s.repair(2, 3))
    yield s


def requested_symbols():
    """5.13-1, 6.15-8 to 6.15-11"""
    s = started("requests for repair symbols", 4)
    s.requests = True
    all_corrected(s, 1, 4)
    s.packet(2, s.corrected(0, 2))
    s.packet(3, s.corrected(1, 3))
    s.get(s.packet(4, s.corrected(0, 4)), s.watermark(4))
    # A packet that arrived and is missing is not named.
    s.get(s.packet(5, s.corrected(2, 5, "attached", parent=3, parent_age=0), checked=False))
    s.get(s.repair(0, 1, 2), *s.refresh(2, 6), *s.refresh(1, 6), *s.refresh(4, 6))
    yield s
    s = started("no request where packets were refreshed since", 2)
    s.requests = True
    all_corrected(s, 1, 2)
    s.packet(2, s.corrected(0, 2))
    s.packet(3, s.corrected(1, 3))
    s.get(s.watermark(3), *s.refresh(2, 4), s.packet(5, s.corrected(0, 5) | {"alias": 9}, checked=False))
    yield s
    s = started("requests for 16 and for 17 packets", 1)
    s.requests = True
    all_corrected(s, 1, 1)
    for step in range(17):
        s.packet(2 + step, s.corrected(0, 2 + step))
    s.get(s.watermark(17, next=17), s.watermark(18), *s.refresh(1, 18))
    yield s
    s = started("no request for a packet 33 numbers ago", 2)
    s.requests = True
    all_corrected(s, 1, 2)
    s.packet(2, s.corrected(1, 2))
    s.get(*[s.packet(3 + step, s.corrected(0, 3 + step)) for step in range(30)], quiet=True)
    s.get(s.packet(33, s.corrected(0, 33)), s.packet(34, s.corrected(0, 34)))
    yield s
    s = started("no request for packets lost before a wrong repair symbol", 2)
    s.requests = True
    all_corrected(s, 1, 2)
    s.packet(2, s.corrected(0, 2))
    s.packet(3, s.corrected(1, 3))
    s.get(s.watermark(3), wrong(s.repair(0, 1), 0, 1))
    s.packet(4, s.corrected(0, 4))
    s.get(s.watermark(4))
    yield s


def arrivals():
    """5.13-2, 6.15-5"""
    s = started("a packet that was rebuilt, is missing again, and arrives twice", 2)
    all_corrected(s, 1, 2)
    data = s.packet(2, s.corrected(0, 2) | {"alias": 9}, checked=False)
    s.get(s.repair(0, 1), data, data, *s.refresh(1, 3, bodies=[0]), data)
    yield s
    s = started("a packet that arrives after it was refreshed", 1)
    all_corrected(s, 1, 1)
    late = s.packet(2, s.corrected(0, 2))
    s.get(s.watermark(2), *s.refresh(1, 2), late)
    yield s


def last_numbers():
    """6.15-3, 6.15-7"""
    s = started("a repair symbol of the snapshot moves the last number", 2, next=1000)
    s.sent[999] = s.packet(1, s.corrected(0, 1), s.corrected(1, 1))
    s.get(s.sent[1000], quiet=True)
    s.packet(2, s.corrected(0, 2))
    s.packet(3, s.corrected(1, 3))
    s.sent[1020] = s.sent[1000]
    s.get(s.repair(0, 999, 1020), wrong(s.repair(1, 1001), 1, 1001), s.repair(2, 1002))
    yield s
    s = started("a repair symbol too far ahead moves no number", 1)
    all_corrected(s, 1, 1)
    lost = s.packet(2, s.corrected(0, 2))
    s.get(s.packet(3, s.corrected(0, 3)), made(35, 0, b"\x01"), lost)
    yield s
    s = started("a packet rebuilt in a stream with a long id", 1, stream=20)
    all_corrected(s, 1, 1)
    s.packet(2, s.corrected(0, 2))
    s.get(s.repair(0, 1))
    yield s


# Rules that an implementation broke unseen


def large_numbers():
    """5.4-6"""
    # An expectation of 4095 is reached after some ninety numbers above it. Most of these bodies do not exist.
    s = started("many numbers above 4095 in one context", 1)
    far = {"mode": "same", "age": 1, "position": [5000, 0, 0], "turn": [0, 0, 0]}
    many = [{"alias": 1 + index, "body": 100 + index} | far for index in range(110)]
    s.get(s.packet(1, s.corrected(0, 1), *many), s.checksum(1))
    yield s


def least_ages():
    """5.6-18"""
    s = started("a parent whose track is later, in the same publish interval", 2, publish_interval=3)
    s.control(s.event(placed(0, origin=4)))
    s.get(s.packet(3, s.corrected(1, 3, "attached", parent=0, parent_age=0), checked=False))
    s.settle(6)
    yield s


def overtaken_gravity():
    """6.9-2, 6.9-3"""
    # As after a scene was restored.
    s = started("a change of gravity before the last one", 2)
    s.control(s.event(gravity_changed(8, 0.0, 1.0, 0.0)))
    s.get(s.packet(9, s.keyframe(0, 2)))
    s.control(s.event(gravity_changed(4, 0.0, 2.0, 0.0)))
    s.get(s.packet(12, s.keyframe(1, 2)), s.watermark(14))
    yield s


def replaced_joints():
    """2.4-2, 4.6-8"""
    s = Stream("the joints of a body go when another takes its index", [*[placed(index) for index in range(3)], fixed_to(1, 0, 1), fixed_to(2, 1, 2), fixed_to(3, 0, 2)])
    s.joints = True
    s.join()
    s.control(s.event(placed(1, 1, origin=1)))
    yield s


def lone_names():
    """6.2-8, 6.10-3, 6.13-7, and lines S70, S90 and S105"""
    s = started("a keyframe whose parent does not exist", 2)
    all_corrected(s, 1, 2)
    s.get(s.packet(2, s.keyframe(0, 0, parent=[9, 0])), s.packet(3, s.corrected(1, 3)), s.checksum(3))
    yield s
    s = started("a record of an unknown body before others", 2, choice={"is": "full"})
    s.get(s.full(1, 7, 0, 1))
    yield s
    # Body 0 has alias 0 until it rests, then body 2, which is gone when the refresh comes.
    s = started("a refresh with the alias of a removed body", 3)
    all_corrected(s, 1, 2)
    s.packet(2, s.rests(0, 2))
    s.packet(3, s.corrected(2, 3, alias=0))
    late = s.refresh(2, 3)
    s.control(s.event(removed(2)))
    s.get(s.watermark(3), *late, s.packet(4, s.corrected(0, 4, age=3) | {"alias": 0, "body": None}, checked=False))
    yield s


def rebuilt_between():
    """6.5-2, 6.15-4, and line S25"""
    s = started("a packet rebuilt between two datagrams that wait", 2)
    all_corrected(s, 1, 2)
    s.packet(2, s.corrected(0, 2))
    new = s.event(gravity_changed(3, 0.0, 1.0, 0.0))
    s.get(s.packet(3, s.corrected(1, 3)), *s.refresh(1, 3), s.repair(0, 1, 2))
    s.control(new)
    yield s


def copies_anew():
    """3.2-4, 4.8-5"""
    old = started("a second Joined of a scene that began anew, after touch is lost", 4, fixed_to(4, 0, 1), tick=50)
    all_corrected(old, 51, 4)
    for index in range(3):
        old.packet(52 + index, old.corrected(index, 52 + index))
    old.get(old.packet(55, old.corrected(3, 55)), *old.refresh(1, 55), old.repair(0, 2, 3))
    old.event(gravity_changed(56, 0.0, 1.0, 0.0))
    # The last datagram loses touch, so that the old copy is not kept.
    old.get(old.packet(57, old.corrected(3, 57)), old.watermark(55 + 3601, count=0))
    s = joined_again(old, [placed(index, origin=2) for index in range(3)], tick=2)
    s.joints = s.requests = True
    s.join()
    s.get(s.watermark(3))
    s.packet(4, s.corrected(0, 4))
    s.packet(5, s.corrected(1, 5))
    s.get(s.watermark(5), s.packet(6, s.corrected(2, 6)), s.repair(0, 0, 1), s.repair(1, 0, 1), s.checksum(6))
    yield s
    old = started("a second Joined without a body that had an alias", 2)
    all_corrected(old, 1, 2)
    s = joined_again(old, [placed(1, origin=9)], tick=9, next=40)
    s.join()
    s.get(s.packet(10, s.corrected(1, 10) | {"alias": 0, "body": None}, checked=False))
    yield s
    old = started("a second Joined of a stream with a budget", 1, choice=BUDGET)
    old.get(old.packet(4, old.corrected(0, 4), kind=11, scale=30))
    s = joined_again(old, [placed(0, origin=6)], choice=BUDGET, tick=6, next=3)
    s.join()
    s.get(s.watermark(8, kind=12, scale=9))
    yield s


def greatest_scales():
    """5.17-2"""
    s = started("the greatest bounded error scale", 1, choice=BUDGET)
    s.get(s.watermark(1, kind=12, scale=14 << 31), s.watermark(2, kind=12))
    yield s


def full_symbols():
    """6.15-3, 6.15-10, and lines S142, S143, S159 and S160"""
    s = started("repair symbols to drop while as many as may be are kept", 2)
    lost = lost_pairs(s)
    s.get(s.repair(15, 17, 18), s.repair(50, 0), lost[0])
    yield s
    s = started("a request behind packets that were refreshed", 2)
    s.requests = True
    all_corrected(s, 1, 2)
    for step in range(3):
        s.packet(2 + step, s.corrected(step % 2, 2 + step))
    s.get(s.watermark(4), *s.refresh(1, 4), s.repair(0, 1, 2))
    yield s


# Upstreams


def granted(name, **terms):
    """Two bodies since tick 100; body 1 moves."""
    return Authority(name, [placed(0, kind=2, track="rest", origin=100), placed(1, kind=2, track="uniform", origin=100, linear=[1.0, 0.0, 0.5])], 100, **terms)


def counted_events():
    """6.14-5"""
    for what in ("refresh", "checksum"):
        s = granted(f"a {what} that counts a scene event, in an upstream")
        s.get(s.packet(101, s.keyframe(0, 1)))
        s.get(*s.refresh(0, 102, count=1) if what == "refresh" else [s.checksum(102, count=1)])
        s.step(102)
        s.get(s.checksum(103, off=1))
        s.step(103)
        yield s


def wrong_records():
    """6.14-6"""
    s = granted("refreshes to drop, in an upstream")
    s.packet(101, s.keyframe(0, 1))
    s.get(s.watermark(101))
    good = packets.decoded(s.refresh(0, 102)[0])
    record = good["records"][0]
    attached = {"predictor": 0, "parent": [1, 0], "position": [1, 2, 3], "largest": 3, "others": [0, 0, 0], "linear": [0, 0, 0], "angular": [0, 0, 0]}
    for tick, records in enumerate(([record, record | {"index": 512}], [record | {"alias": 512}], [record | {"keyframe": attached}]), 102):
        s.get(packets.encoded(good | {"tick": tick, "records": records}))
        s.step(tick)
    s.get(s.packet(106, s.keyframe(1, 1) | {"alias": 3}, s.corrected(0, 106, "world", 1) | {"parent_age": 0}, checked=False, number=1))
    s.step(106)
    s.get(packets.encoded(good))
    s.step(107)
    yield s


def silences():
    """6.14-12, 6.14-14"""
    s = granted("an upstream that is silent for long")
    s.get(s.watermark(110))
    s.step(180, 181)
    s.get(s.packet(200, s.keyframe(0, 1, linear=[1.0, 0.0, 0.0])), s.watermark(600))
    s.step(600 + 150 + 60, 600 + 150 + 61)
    yield s
    s = granted("an upstream that is 64 tracks ahead")
    s.get(*[s.packet(102 + step, s.keyframe(0, 1), s.corrected(1, 102 + step)) for step in range(64)])
    s.step(101, 102, 133, 165)
    yield s
    s = granted("an upstream whose lost packets leave the tracks before them")
    s.get(s.packet(110, s.keyframe(0, 1, linear=[1.0, 0.0, 0.0])))
    late = s.packet(120, s.keyframe(0, 1))
    s.get(s.packet(130, s.keyframe(0, 1)), late)
    s.packet(140, s.keyframe(0, 1))
    s.get(s.watermark(140), *s.refresh(3, 141))
    s.step(105, 115, 125, 135, 145)
    yield s


def lanes():
    """6.14-8, 6.14-9"""
    s = granted("an upstream of a lockstep scene", lockstep=True)
    first, second = s.packet(101, s.keyframe(0, 1)), s.packet(102, s.corrected(0, 102), s.corrected(1, 102, "world", 1, moved=True))
    s.get(first)
    s.step(101)
    s.take(first, second)
    s.step(102)
    s.take(s.watermark(103))
    s.step(103)
    yield s
    s = granted("an upstream of a free-running scene, in messages")
    first = s.packet(101, s.keyframe(0, 1))
    s.take(first)
    s.step(101)
    s.get(first)
    s.step(102)
    yield s


def first_tracks():
    """6.14-3"""
    event = placed(0, kind=2, origin=100)
    event["track"]["payload"]["anchor"] |= {"present": 2, "linear": digits([0.0, -0.0, 0.0])}
    s = Authority("an upstream of a body whose velocity is -0", [event], 100)
    s.get(s.checksum(100))
    s.step(101)
    yield s


def limits():
    """6.14-13"""
    s = granted("an upstream of bodies that would leave the limits")
    s.get(s.packet(101, s.keyframe(0, 1, at=[99999.5, 0.0, 3.0], linear=[12.0, 0.0, 6.0]), s.keyframe(1, 1, at=[1.0, -99999.0, 0.0], linear=[0.0, -60.0, 0.0])))
    s.step(*range(101, 107))
    # Its pose in f32 is at the limit.
    s.get(s.packet(107, s.keyframe(0, 0, at=[0.0, 100000.003, 0.0]), s.keyframe(1, 1, at=[0.0, 0.0, -100000.0], linear=[0.0, 0.0, 1.0])))
    s.step(*range(107, 110))
    s.get(s.packet(110, s.keyframe(0, 0, at=[0.0, 100000.01, 0.0]), s.keyframe(1, 1, at=[0.0, 5.0, 0.0], linear=[1.0, 0.0, 0.0])))
    s.step(110, 111)
    yield s


def streams():
    makers = (newest_ticks, published_ticks, snapshot_packets, snapshot_waits, unknown_events, joints, unreadable_updates, replaced_tracks, named_refreshes, second_snapshots, late_assignments)
    more = (spans, seventeenth_symbols, after_wrong_symbols, requested_symbols, arrivals, last_numbers)
    last = (large_numbers, least_ages, overtaken_gravity, replaced_joints, lone_names, rebuilt_between, copies_anew, greatest_scales, full_symbols)
    return [s for maker in (*makers, *more, *last) for s in maker()]


def upstreams():
    return [s for maker in (counted_events, wrong_records, silences, lanes, first_tracks, limits) for s in maker()]
