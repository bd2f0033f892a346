"""Makes the scripted golden streams, spec/vectors/scripted.json.

Usage: python3 make_streams.py [--write]. Without --write it compares; the exit code is 1 if the file is another.
Each function is one stream; its docstring cites the clauses that the stream is about. rule_streams.py has streams of
single rules.
"""

import json
import sys
from pathlib import Path

import packets
import refused
import rule_streams
from scripted import SURFACE, Authority, Dice, Stream, digits, gravity_changed, placed, removed

FILE = Path(__file__).resolve().parent.parent / "vectors" / "scripted.json"
BUDGET = {"is": "within a budget", "rate": 2000, "burst": 1200, "choice": SURFACE}
PARTS = {"is": "within a parts tolerance", "micrometres": 5000, "microradians": 2000}


def bodies(count, **terms):
    """Bodies of alternating shapes."""
    return [placed(index, shape=index % 2, **terms) for index in range(count)]


def started(name, events, **terms):
    s = Stream(name, events, **terms)
    s.join()
    return s


def several_packets():
    """6.2-5, 6.2-6, 6.4-4, 6.6-2 to 6.6-5, 6.8-1 to 6.8-5"""
    s = started("several packets of a tick, lost at either end", bodies(4))
    s.get(s.packet(1, s.corrected(0, 1), s.corrected(1, 1, moved=True), kind=0), s.packet(1, s.corrected(2, 1), s.corrected(3, 1)))
    first, last = s.packet(2, s.corrected(0, 2), kind=0), s.packet(2, s.corrected(1, 2), s.corrected(2, 2, moved=True))
    s.get(last, last, first, first)
    s.packet(3, s.corrected(0, 3), s.corrected(2, 3), kind=0)
    s.get(s.packet(3, s.corrected(1, 3), kind=0))
    lost = s.packet(3, s.corrected(3, 3))
    s.get(s.packet(5, s.corrected(1, 5, moved=True), kind=0))
    s.get(*s.refresh(4, 4), s.watermark(5), lost, *s.refresh(6, 5), *s.refresh(4, 5))
    s.get(s.watermark(9))
    s.packet(10, s.corrected(3, 10, "world", 2, moved=True))
    s.get(s.watermark(10), s.watermark(12), s.watermark(11), *s.refresh(8, 12), s.checksum(12))
    return s


def every_third_tick():
    """5.6-18, 6.2-5, 6.3-1, 6.3-3, 6.4-4, 6.8-4"""
    events = bodies(4, track="ballistic", linear=[1.0, 2.0, 0.0])
    s = started("every third tick, with lookahead", events, publish_interval=3, lookahead=4)
    s.get(s.packet(3, s.corrected(0, 3), s.corrected(1, 3, "world", 1), kind=0), s.packet(3, s.corrected(2, 3)))
    s.get(s.packet(6, s.corrected(0, 6), kind=0))
    s.control(s.event(gravity_changed(8, 0.0, 3.0, 0.0)))
    s.get(s.packet(6, s.corrected(1, 6, "world", 2, moved=True)), s.packet(9, s.corrected(1, 9), s.keyframe(3, 2), kind=0))
    s.control(s.event(placed(7, origin=11, track="ballistic")))
    s.get(s.packet(9, s.corrected(0, 9, "world", 2)))
    s.get(s.packet(12, s.corrected(7, 12), s.corrected(0, 12)), s.watermark(18), s.packet(21, s.corrected(7, 21, size=1), s.corrected(1, 21)))
    s.get(s.checksum(24))
    return s


def predictors():
    """6.1-4, 6.1-5, 6.2-4 to 6.2-8, 6.9-1"""
    events = [*bodies(6, linear=[1.0, 0.5, 0.0]), placed(6, kind=2, shape=1, linear=[0.0, 1.0, 0.0])]
    events += [placed(7, kind=1, shape=1, **{"gravity scale": "3e99999a", "tolerance scale": 2})]
    events += [placed(8, kind=2, **{"gravity scale": "3f000000", "damping": {"linear": "3f800000", "angular": "3f800000"}})]
    events += [placed(9, kind=0, track="rest"), placed(10, linear=[4.0, 0.0, 0.0], damping={"linear": "40000000", "angular": "3f800000"})]
    s = started("each predictor, and rests of each kind", events, choice=PARTS)
    for tick, wide in ((1, 1), (4, 40), (9, 300)):
        s.get(s.packet(tick, *[s.corrected(index, tick, "world", index % 6, moved=index % 6 > 0, size=wide) for index in range(9)]))
        s.get(s.packet(tick + 1, *[s.corrected(index, tick + 1, moved=index % 6 > 0 and index > 3) for index in range(9)]))
    s.get(s.packet(13, *[s.keyframe(index, 2, linear=[3.0, 1.0, 0.0], angular=[0.5, 2.0, 1.0]) for index in (0, 6, 7, 8, 9)]))
    s.get(s.packet(17, s.corrected(1, 17, "world", 0), s.rests(2, 17), s.keyframe(3, 0, state=True), s.keyframe(4, 0), s.keyframe(5, 1, state=True, linear=[1.0, 0.0, 0.0])))
    s.get(s.watermark(22), s.packet(40, s.corrected(1, 40), s.corrected(2, 40, "world", 2), s.rests(3, 40), s.corrected(4, 40), s.corrected(5, 40)))
    s.get(s.packet(41, s.rests(3, 41), s.corrected(4, 41, "world", 4, moved=True)), s.packet(60, s.corrected(6, 60), s.corrected(8, 60, moved=True)))
    s.get(s.packet(61, s.keyframe(0, 5), s.keyframe(3, 0, state=True)), s.packet(64, s.corrected(0, 64), s.rests(3, 64)))
    s.get(s.packet(300, s.corrected(0, 300), s.corrected(3, 300), s.corrected(7, 300)), s.packet(700, s.corrected(0, 700), s.corrected(1, 700)), s.checksum(700))
    return s


def attached():
    """6.2-1, 6.2-3, 6.2-4, 6.3-13, 6.6-10, 6.8-4"""
    s = started("attached bodies", bodies(6))
    # Aliases fall while parents rise: a child's update often stands before its parent's.
    s.get(s.packet(1, *[s.corrected(index, 1, alias=9 - index) for index in range(6)]))
    s.get(s.packet(2, s.corrected(3, 2, "attached", parent=0), s.corrected(5, 2, "attached", parent=0, parent_age=1)))
    s.get(s.packet(3, s.corrected(0, 3, moved=True), s.corrected(4, 3, "attached", parent=0, parent_age=0), s.corrected(3, 3)))
    s.get(s.packet(4, s.corrected(0, 4), s.corrected(5, 4, "world", 1, moved=True, parent_age=0), s.corrected(3, 4)))
    s.get(s.packet(6, s.corrected(5, 6, "attached", parent=4, parent_age=3), checked=False))
    # 6.6-10: the parent is attached itself, so the packet cannot be read.
    s.get(*s.refresh(s.number - 1, 6))
    s.get(s.packet(7, s.corrected(4, 7, "world", 2, moved=True), s.corrected(2, 7, "attached", parent=4, parent_age=0)))
    s.get(s.packet(8, s.keyframe(1, 0, parent=[0, 0]), s.corrected(0, 8)))
    s.get(s.packet(8 + 1, s.corrected(0, 9), kind=0), s.packet(9, s.corrected(1, 9), s.corrected(3, 9)))
    late = s.packet(10, s.corrected(0, 10), kind=0)
    s.get(s.packet(10, s.corrected(5, 10, "attached", parent=0), s.corrected(1, 10, "world", 1, moved=True)), late)
    s.control(s.event(removed(0)))
    s.get(s.watermark(11), s.packet(12, s.keyframe(2, 1), s.corrected(3, 12)), s.checksum(13))
    s.control(s.event(placed(0, generation=1, origin=13)))
    s.get(s.packet(14, s.corrected(3, 14), s.corrected(0, 14)), s.packet(15, s.keyframe(3, 2), s.corrected(5, 15)), s.checksum(15))
    return s


def parent_becomes_attached():
    """RECKONING 3.8-4, 3.8-5"""
    s = started("a parent that becomes attached, and is removed", bodies(4))
    s.get(s.packet(1, *[s.corrected(index, 1, moved=True) for index in range(4)]))
    s.get(s.packet(2, s.corrected(1, 2, "attached", parent=0)), s.packet(3, s.corrected(0, 3, "attached", parent=2)))
    s.get(s.watermark(6), s.packet(8, s.corrected(2, 8, moved=True)), s.checksum(9))
    s.control(s.event(removed(0)))
    s.get(s.watermark(12))
    return s


def wrong_parents():
    """6.2-2, 6.6-6, 6.6-10, and lines S75 to S82"""
    s = started("attachments that cannot be read", bodies(6))
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(6)]), s.packet(2, s.corrected(1, 2, "attached", parent=0)))
    # Ignored: there is no such parent, and no such body.
    s.get(s.packet(3, s.corrected(2, 3, "attached", parent=40, parent_age=1) | {"alias": 2}), s.packet(3, s.corrected(2, 3) | {"alias": 30, "body": 77}))
    wrong = [
        s.corrected(2, 3, "attached", parent=0, parent_age=1),
        s.corrected(2, 4, "attached", parent=2, parent_age=3),
        s.corrected(2, 5, "attached", parent=1, parent_age=3),
        s.corrected(1, 6, "attached", parent=3, parent_age=5),
        s.corrected(1, 7, "world", 1, parent_age=None) | {"parent_age": None},
        s.corrected(3, 8, "world", 1, parent_age=7),
        s.corrected(1, 9) | {"age": 8},
        s.corrected(1, 10, "world", 1, parent_age=8),
        s.corrected(3, 11, "attached", parent=0, parent_age=9),
        s.rests(1, 12, alias=1),
    ]
    s.packet(3, s.corrected(0, 3, moved=True))
    for place, update in enumerate(wrong):
        tick = 3 + place
        data = s.packet(tick, update, checked=False)
        s.get(data)
    s.get(*[part for number in range(4, s.number) for part in s.refresh(number, 20, bodies=[0, 1, 2, 3])], s.watermark(20))
    s.settle(21)
    return s


def refreshes():
    """6.6-3, 6.6-7, 6.6-8, 6.7-3, 6.7-8, 6.7-7, 6.8-1, 6.8-2"""
    s = started("refreshes in several parts", bodies(8))
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(8)]))
    s.packet(2, *[s.corrected(index, 2, moved=True) for index in range(6)])
    parts = s.refresh(1, 2, 3)
    newer = s.packet(3, s.corrected(0, 3), s.corrected(4, 3, moved=True))
    later = s.refresh(1, 3, 3)
    s.get(newer, parts[1], parts[1], parts[0], later[0], parts[2], later[2], s.watermark(4), later[1])
    s.get(s.packet(5, s.corrected(6, 5)), *s.refresh(1, 5), *later)
    # A part of the same refresh that counts more parts, or more scene events, belongs to another refresh.
    s.packet(6, *[s.corrected(index, 6) for index in range(4)])
    two, three = s.refresh(4, 6, 2), s.refresh(4, 6, 3)
    s.get(s.watermark(6), two[0], three[1], two[1], three[2])
    s.control(s.event(gravity_changed(6, 0.0, -5.0, 0.0)))
    counted = s.refresh(4, 6, 3)
    s.get(counted[0], three[0], counted[1], counted[2], s.watermark(7))
    s.packet(7, s.corrected(5, 7), s.corrected(7, 7))
    older, newer = s.refresh(5, 7, 2), s.refresh(5, 8, 2)
    s.get(s.watermark(7), newer[0], older[1], newer[1])
    # The refresh is older than a packet that waits for what was lost.
    s.packet(8, s.corrected(0, 8), s.corrected(1, 8))
    old = s.refresh(6, 8)
    s.get(s.packet(9, s.corrected(0, 9)), s.packet(10, s.corrected(2, 10)), *old, s.packet(11, s.corrected(1, 11)))
    s.get(*s.refresh(7, 12), s.watermark(12))
    # The refresh is newer, so it contains what the waiting packets say.
    s.packet(13, s.corrected(0, 13), s.corrected(1, 13))
    s.get(s.packet(14, s.corrected(0, 14)), s.packet(15, s.corrected(1, 15, moved=True), kind=0), *s.refresh(10, 16), s.packet(16, s.corrected(0, 16)))
    s.get(s.watermark(16), s.checksum(16))
    # A refresh without records, and one of a body that was removed.
    s.packet(17, s.corrected(7, 17))
    s.control(s.event(removed(7)))
    s.get(s.watermark(18), *s.refresh(s.number - 1, 18), s.packet(19, s.corrected(0, 19)), s.checksum(19))
    return s


def late_packets():
    """6.6-3, 6.6-6, 6.6-8, 6.6-9, 6.6-11, 6.6-12, 6.8-1, 6.8-3"""
    s = started("packets in another order", bodies(5))
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(5)]))
    order = [s.packet(2 + step, s.corrected(step % 3, 2 + step, moved=step % 2 == 0), s.corrected(3, 2 + step)) for step in range(6)]
    s.get(order[2], order[1], order[0], order[5], order[4], order[3], s.watermark(8))
    # A late keyframe is the track between its neighbours; a late correction leaves a gap.
    before, kept, between, after = (s.packet(9 + step, s.keyframe(0, 1), s.corrected(1, 9 + step), s.keyframe(2, 2), kind=step % 2) for step in range(4))
    s.get(before, after, kept, between, s.watermark(12))
    first, second, third = s.packet(13, s.corrected(0, 13)), s.packet(14, s.corrected(1, 14), s.keyframe(4, 1)), s.packet(15, s.keyframe(0, 1), s.keyframe(1, 1), kind=0)
    s.get(third, first, second, s.packet(15, s.corrected(2, 15)), s.watermark(16))
    # A body that gets a later keyframe first, and then its earlier correction.
    early, key = s.packet(17, s.corrected(3, 17), s.corrected(4, 17)), s.packet(18, s.keyframe(3, 1), kind=0)
    s.get(key, early, s.watermark(18), s.packet(19, s.corrected(3, 19), kind=0), s.watermark(19))
    # Unread packets with several gaps before them; the second gap is filled first.
    a, b, c, d = (s.packet(20 + step, s.corrected(step // 2, 20 + step), kind=step % 2) for step in range(4))
    s.get(d, b, a, c)
    e = s.packet(25, s.corrected(0, 25))
    refresh = s.refresh(s.number - 1, 25)
    f, g = s.packet(26, s.corrected(1, 26)), s.packet(27, s.corrected(0, 27), s.corrected(1, 27))
    s.get(g, *refresh, f, e)
    s.settle(28)
    # A keyframe overtakes a correction that names its body: the ticks between are not known; after a keyframe they are.
    for tick, late_kind in ((30, "correction"), (34, "keyframe")):
        late = s.packet(tick, s.corrected(0, tick, alias=0) if late_kind == "correction" else s.keyframe(0, 1), s.corrected(1, tick))
        s.get(s.packet(tick + 1, s.keyframe(0, 1), kind=0), late, s.packet(tick + 1, s.corrected(2, tick + 1)), s.watermark(tick + 2))
    s.settle(37)
    return s


def ahead_of_events():
    """6.5-2, 6.5-3, 6.11-2, 6.11-3"""
    s = Stream("datagrams ahead of their scene events", bodies(3), tick=70000, next=131070, count=65535, choice=SURFACE)
    early = s.packet(70001, s.corrected(0, 70001))
    s.get(early, quiet=True)
    s.join(upto=3)
    s.get(s.packet(70002, s.corrected(1, 70002)), early, s.watermark(70002))
    s.end_snapshot()
    s.get(s.packet(70003, s.corrected(2, 70003)))
    new = s.event(placed(5, origin=70003))
    uses, uses_too = s.packet(70004, s.corrected(5, 70004), kind=0), s.packet(70004, s.corrected(0, 70004))
    gone = s.event(removed(1))
    after = s.packet(70005, s.corrected(5, 70005))
    s.get(after, uses, s.watermark(70006, count=s.count - 2, next=131073), uses_too)
    s.control(new)
    s.get(s.packet(70006, s.corrected(2, 70006), count=s.count - 1), s.repair(3, 131076))
    s.control(gone)
    s.get(*[s.packet(70007 + step, s.corrected(5, 70007 + step)) for step in range(2)], s.checksum(70008))
    # A waiting packet has not arrived for gaps; a refresh waits too.
    third = s.event(gravity_changed(70009, 1.0, 0.0, 0.0))
    lost = s.packet(70009, s.corrected(0, 70009))
    s.get(s.watermark(70009, count=s.count - 1), *s.refresh(s.number - 1, 70010), lost)
    s.control(third)
    s.get(s.checksum(70010))
    return s


def many_wait():
    """6.5-2"""
    s = started("more datagrams than may wait", bodies(2))
    new = s.event(placed(5, origin=0))
    fill = [s.watermark(1) for _ in range(511)]
    s.get(*fill, quiet=True)
    s.get(s.packet(2, s.corrected(0, 2)), s.packet(3, s.corrected(1, 3)))
    s.control(new)
    s.get(s.watermark(3), *s.refresh(1, 3), s.checksum(3))
    return s


def aliases():
    """6.13-1, 6.13-3, 6.13-5 to 6.13-12"""
    s = started("aliases that change hands under loss", [placed(0, alias=5), placed(1, alias=1), *[placed(index) for index in range(2, 7)]])
    s.get(s.packet(1, s.corrected(0, 1), s.corrected(1, 1)))
    s.get(s.packet(2, *[s.corrected(index, 2) for index in (2, 3, 4)]))
    # Body 1 loses alias 0 by coming to rest; body 5 gets it. The assignment is lost.
    rest = s.packet(3, s.rests(1, 3))
    taken = s.packet(4, s.corrected(5, 4))
    s.get(rest, s.packet(5, s.corrected(5, 5)), s.packet(6, s.corrected(0, 6)), taken, s.watermark(6))
    # The same, and a refresh says who has it.
    s.get(s.packet(7, s.keyframe(2, 0, state=True)))
    s.packet(8, s.corrected(6, 8))
    s.get(s.packet(9, s.corrected(6, 9)), *s.refresh(s.number - 2, 9), s.packet(10, s.corrected(6, 10)))
    s.get(*s.refresh(s.number - 2, 11), s.watermark(11))
    # A body takes another alias while the packets with the older one are late.
    old = s.packet(12, s.corrected(3, 12))
    moved = s.packet(13, s.corrected(3, 13, alias=20))
    again = s.packet(14, s.corrected(3, 14), s.corrected(4, 14, alias=2))
    s.get(again, old, moved, s.watermark(14), s.packet(15, s.corrected(4, 15), s.corrected(3, 15)))
    # A late assignment of an alias that names another body since.
    first = s.packet(16, s.rests(4, 16))
    second = s.packet(17, s.corrected(1, 17, alias=2))
    third = s.packet(18, s.rests(1, 18))
    fourth = s.packet(19, s.corrected(2, 19, alias=2))
    s.get(first, fourth, second, third, s.packet(20, s.corrected(2, 20)), s.watermark(20))
    # A record without an alias ends it; a late packet with that alias is missing.
    resting = s.packet(21, s.corrected(0, 21))
    s.packet(22, s.rests(0, 22))
    s.get(s.watermark(22), *s.refresh(s.number - 1, 22), resting, s.packet(23, s.corrected(1, 23, alias=4)), *s.refresh(s.number - 3, 23))
    s.get(s.packet(24, s.corrected(1, 24)), s.checksum(24))
    # The body of an alias is removed, and another one placed at its index.
    on_the_way = s.packet(25, s.corrected(6, 25))
    s.control(s.event(removed(6)))
    s.get(on_the_way)
    s.control(s.event(placed(6, generation=1, origin=25)))
    s.get(*s.refresh(s.number - 1, 26), s.packet(27, s.corrected(6, 27)), s.packet(28, s.corrected(6, 28)))
    s.settle(29)
    return s


def more_aliases():
    """Lines S114 to S120"""
    s = started("assignments in another order", [placed(index, alias=index + 1) for index in range(5)])
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(5)]))
    # A keyframe overtakes an assignment to the same body: the body has moved on, and takes no alias.
    early = s.packet(2, s.corrected(0, 2, alias=10))
    key = s.packet(3, s.keyframe(0, 1, alias=11))
    s.get(key, early, s.packet(4, s.corrected(0, 4)))
    # An older assignment of the alias that the body already has.
    s.alias[1] = 12
    older, newer = s.packet(5, s.keyframe(1, 1)), s.packet(6, s.keyframe(1, 1))
    s.get(newer, older, s.packet(7, s.corrected(1, 7)))
    # An assignment that another body's alias precedes: alias 3 goes from body 3 to body 2.
    s.alias.pop(3)
    takes = s.packet(8, s.keyframe(2, 1, alias=3))
    s.get(takes, s.packet(9, s.corrected(2, 9)), s.packet(10, s.corrected(3, 10, alias=2)), s.packet(11, s.corrected(3, 11), s.corrected(2, 11)))
    # A refresh gives an alias to a body with a newer track, and to none.
    lost = s.packet(12, s.corrected(4, 12, alias=14))
    s.get(s.watermark(12))
    at_12 = s.refresh(s.number - 1, 12)
    s.get(s.packet(13, s.keyframe(4, 1, alias=15)), *at_12, s.packet(14, s.corrected(4, 14)), lost)
    s.get(*s.refresh(s.number - 3, 14), s.packet(15, s.corrected(4, 15)), s.checksum(15))
    # Two refreshes in the wrong order: the older one may not take the alias back.
    s.packet(16, s.corrected(0, 16))
    s.get(s.watermark(16))
    past = s.refresh(s.number - 1, 16)
    s.alias.pop(0)
    s.packet(17, s.keyframe(4, 1, alias=11))
    s.get(s.watermark(17), *s.refresh(s.number - 1, 17), *past, s.packet(18, s.corrected(4, 18)))
    s.get(s.packet(19, s.corrected(0, 19, alias=4)), s.packet(20, s.corrected(0, 20), s.corrected(4, 20)), s.checksum(20))
    # An update that names its body applies, whatever the assignment does.
    late = s.packet(21, s.corrected(1, 21, alias=30))
    s.alias.pop(1)
    s.packet(22, s.keyframe(3, 1, alias=30))
    s.get(s.packet(23, s.corrected(3, 23)), late)
    s.get(*s.refresh(s.number - 2, 24), *s.refresh(s.number - 1, 24), s.packet(25, s.corrected(1, 25, alias=31)))
    s.settle(26)
    return s


def checksums():
    """6.12-1 to 6.12-6, 6.7-10"""
    s = started("checksums", [*bodies(5), placed(8, kind=0, track="rest")])
    s.get(s.packet(1, *[s.corrected(index, 1, "world", index, moved=index > 0) for index in range(5)]), s.checksum(1))
    s.get(s.packet(2, s.keyframe(0, 5), s.keyframe(1, 0, state=True), s.corrected(2, 2, "attached", parent=3)), s.checksum(3))
    # Sums of another state are not compared: numbers differ, events differ, or something is missing.
    s.get(s.checksum(3, off=1, next=s.number - 1))
    ahead = s.packet(4, s.corrected(0, 4))
    s.get(s.checksum(4, off=1), ahead)
    new = s.event(placed(6, origin=4))
    s.get(s.checksum(5, off=1))
    s.control(new)
    return s


def differing_checksum():
    """6.12-5, 6.12-6, 6.7-10, 6.8-6"""
    s = started("a checksum that differs", bodies(3))
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(3)]))
    s.control(s.event(gravity_changed(1, 0.0, 1.0, 0.0)))
    s.get(s.checksum(2, off=7, count=0), s.packet(3, s.corrected(0, 3)), s.checksum(4))
    s.get(s.checksum(6, off=1 << 32), s.packet(7, s.corrected(0, 7)), s.watermark(8), s.checksum(9))
    return s


def budget():
    """5.17, 6.16-9 to 6.16-13"""
    s = started("a budget that does not suffice", bodies(4), choice=BUDGET, tick=10)
    s.get(s.watermark(11, kind=12, scale=12))
    s.get(s.packet(12, s.corrected(0, 12), kind=11, scale=9), s.packet(15, s.corrected(1, 15), kind=0), s.packet(15, s.corrected(2, 15), kind=11, scale=16))
    s.get(s.watermark(18), s.packet(19, s.corrected(0, 19), kind=11, scale=None), s.watermark(20, kind=12, scale=None), s.watermark(21, kind=12, scale=20))
    late = s.packet(22, s.corrected(3, 22), kind=11, scale=30)
    s.get(s.packet(25, s.corrected(0, 25), kind=11, scale=10), late, s.watermark(27, kind=12, scale=44), s.watermark(27))
    s.packet(28, s.corrected(1, 28))
    s.get(s.watermark(30, kind=12, scale=14), *s.refresh(s.number - 1, 30), s.watermark(31), s.packet(34, s.corrected(1, 34), kind=11, scale=480))
    # Packets over budget are not kept for a second reading.
    a, b = s.packet(35, s.corrected(2, 35)), s.packet(36, s.corrected(2, 36), kind=11, scale=12)
    s.get(b, a, *s.refresh(s.number - 1, 37), s.checksum(38), s.watermark(39, kind=12, scale=11))
    # Packets of one tick: only the last one states a scale, for the ticks since the packet before.
    s.get(s.packet(41, s.corrected(0, 41)), s.packet(44, s.corrected(1, 44), kind=0), s.packet(44, s.corrected(2, 44), kind=11, scale=18), s.watermark(46))
    one, two = s.packet(48, s.corrected(0, 48), kind=11, scale=10), s.packet(50, s.corrected(1, 50), kind=11, scale=13)
    s.get(two, one, s.watermark(52, kind=12, scale=15))
    # A packet that is not read again has given its body an alias; an older assignment does not take it away.
    s.get(s.packet(54, s.corrected(3, 54, alias=30)))
    early, over = s.packet(55, s.corrected(3, 55, alias=32)), s.packet(56, s.corrected(3, 56, alias=33), kind=11, scale=9)
    s.get(over, early, s.packet(57, s.corrected(3, 57)))
    s.settle(58)
    return s


def no_budget():
    """5.17-1, 5.8-8, 5.8-6"""
    s = started("datagrams of other streams and kinds", bodies(2), largest_packet=700)
    s.get(s.packet(1, s.corrected(0, 1)))
    second = s.packet(2, s.corrected(0, 2))
    s.get(s.watermark(9, kind=12, scale=9), b"\x5b\x09" + second[1:])
    s.stream = 6
    s.get(s.watermark(9), *s.refresh(1, 9))
    s.stream = 20
    s.get(s.watermark(9))
    s.stream = 5
    s.get(bytes.fromhex("560100090000010100"), second, s.watermark(3))
    s.get(s.watermark(4) + b"\x00", b"\x58\x00", s.packet(5, s.corrected(1, 5))[:-1], *s.refresh(2, 5))
    heavy = [{"alias": 90 + index, "body": 90 + index, "keyframe": s.keyframe(0, 1, state=True)["keyframe"]} for index in range(13)]
    heavy.append(s.corrected(0, 6))
    s.get(s.packet(6, *heavy), s.packet(7, *heavy[:11]), s.packet(8, s.corrected(1, 8)))
    s.settle(9)
    return s


def redundancy():
    """5.16, 6.15-2 to 6.15-7"""
    s = started("packets rebuilt from repair symbols", bodies(6))
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(6)]))
    s.packet(2, s.corrected(0, 2))
    s.get(s.packet(3, s.corrected(1, 3)), s.repair(0, 1, 2), s.repair(0, 1, 2))
    # Two of three are lost: the first symbol is kept until the second comes. They are rebuilt in rising order.
    a, b, c = s.packet(4, s.corrected(0, 4)), s.packet(5, s.corrected(0, 5)), s.packet(6, s.corrected(1, 6))
    s.get(c, s.repair(1, 3, 4, 5), s.repair(1, 3, 4, 5), s.repair(9, 3, 4, 5), a, b)
    # A packet is rebuilt, and late packets of which it was one arrive afterwards.
    s.packet(7, s.corrected(2, 7))
    s.get(s.repair(4, 6), s.packet(8, s.corrected(2, 8)), s.watermark(8))
    # The symbol comes before the packets that it covers; an unread packet is read again afterwards.
    d, e = s.packet(9, s.corrected(3, 9)), s.packet(10, s.corrected(3, 10))
    s.get(s.repair(2, 8, 9), e, s.checksum(10), s.repair(3, 7, 8, 9))
    # A packet waits for a scene event: it has not arrived, but a rebuilt one is there for further symbols at once.
    new = s.event(placed(9, origin=10))
    s.packet(11, s.corrected(9, 11))
    s.packet(12, s.corrected(9, 12))
    s.get(s.repair(5, 10), s.repair(6, 10, 11))
    s.control(new)
    newer = s.event(placed(10, origin=11))
    waits, gone = s.packet(12, s.corrected(10, 12)), s.packet(12, s.corrected(0, 12, moved=True), count=s.count - 1)
    s.get(waits, s.repair(7, 12, 13))
    s.control(newer)
    s.get(s.packet(12, s.corrected(1, 12)))
    s.get(s.watermark(12), s.checksum(12), d)
    return s


def wrong_repair_symbols():
    """6.15-3, 6.15-6, 6.15-7"""
    s = Stream("repair symbols that are wrong or old", bodies(3), next=65500, tick=4)
    s.get(s.repair(0, 65500) if s.packet(5, s.corrected(0, 5)) else b"", quiet=True)
    s.join(upto=2)
    s.get(s.repair(1, 65500))
    s.end_snapshot()
    s.get(s.repair(2, 65500))
    snapshot = s.sent[65500]
    s.sent[65499] = snapshot
    s.packet(6, s.corrected(1, 6))
    s.get(s.repair(3, 65499, 65501), s.watermark(6), *s.refresh(65501, 6))
    # A wrong symbol gives a malformed packet: all symbols are dropped, and those of known packets from then on.
    s.packet(7, s.corrected(0, 7))
    s.packet(8, s.corrected(0, 8))
    good, wrong = s.repair(4, 65502, 65503), bytearray(s.repair(5, 65503))
    wrong[5] ^= packets.times(packets.factor(5, 65503), 1 ^ 15)  # the kind becomes 15
    s.get(good, bytes(wrong), s.sent[65503], s.watermark(8), s.repair(6, 65502))
    s.get(*s.refresh(65502, 8), *[s.packet(9 + step, s.corrected(step % 3, 9 + step)) for step in range(34)])
    lost = s.packet(50, s.corrected(2, 50))
    s.get(s.packet(51, s.corrected(1, 51)), s.repair(7, s.number - 2))
    # Too far ahead, and too old.
    ahead = {number: s.packet(60 + number, s.corrected(0, 60 + number)) for number in range(33)}
    s.get(s.repair(8, s.number - 1), s.repair(8, s.number - 2), s.watermark(100), *list(ahead.values())[:-3])
    s.get(s.repair(9, s.number - 1, s.number - 2, s.number - 3, s.number - 33), s.repair(10, s.number - 33), lost)
    s.settle(101)
    return s


def many_repair_symbols():
    """6.15-3"""
    s = started("more repair symbols than are kept", bodies(3))
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(3)]))
    lost = [s.packet(2 + step, s.corrected(step % 3, 2 + step)) for step in range(20)]
    # The first of 17 is dropped, so the packet that only it covers stays lost.
    s.get(s.repair(0, 1, 2), *[s.repair(step, 3 + step, 4 + step) for step in range(16)], quiet=True)
    s.get(lost[0], lost[2], s.watermark(22))
    # The same row of the same lacking packets is dropped, and pushes out no other.
    s.get(*[s.repair(3, 6, 7)] * 17, quiet=True)
    s.get(lost[18], s.watermark(23), lost[19])
    s.settle(24)
    return s


def dropped_repair_symbols():
    """6.15-3, 6.15-6, 6.15-7"""
    s = started("repair symbols of the snapshot, repeated ones, and those after a wrong one", bodies(5), next=1000, tick=4)
    s.get(s.packet(5, *[s.corrected(index, 5) for index in range(5)]))
    # Two symbols over a lost packet and one of the snapshot rebuild neither.
    s.sent[999] = s.sent[1000]
    s.packet(6, s.corrected(0, 6))
    s.get(s.repair(0, 999, 1001), s.repair(1, 999, 1001), s.watermark(6), *s.refresh(1001, 6))
    # A symbol is repeated after packets that it covers arrived: it pushes out no other.
    lost = [s.packet(7 + step, s.corrected(step % 5, 7 + step)) for step in range(7)]
    covered = range(1004, 1009)
    s.get(s.repair(2, 1002, 1003), s.repair(3, *covered), lost[4], lost[5], *[s.repair(3, *covered)] * 16, quiet=True)
    s.get(lost[0], s.watermark(13), lost[2], lost[3], lost[6])
    # After a wrong symbol, those that lack no earlier packet are used at once.
    s.packet(14, s.corrected(0, 14))
    s.packet(15, s.corrected(1, 15))
    wrong = bytearray(s.repair(5, 1010))
    wrong[5] ^= packets.times(packets.factor(5, 1010), 1 ^ 15)  # the kind becomes 15
    s.get(bytes(wrong), s.repair(6, 1010))
    s.packet(16, s.corrected(2, 16))
    s.get(s.packet(17, s.corrected(3, 17)), s.repair(7, 1011))
    # One that lacks an earlier packet is dropped, and still moves the last number: 1002 is forgotten.
    later = {1013 + step: s.packet(18 + step, s.corrected(step % 5, 18 + step)) for step in range(28)}
    s.get(s.repair(8, 1009, 1040), s.repair(9, 1002, 1030))
    s.get(*[data for number, data in later.items() if number != 1030], quiet=True)
    s.get(s.watermark(46), later[1030])
    s.settle(47)
    return s


def gravities():
    """6.9-1 to 6.9-5"""
    events = [*bodies(3, track="ballistic", origin=20), gravity_changed(20, 0.0, 4.0, 0.0), gravity_changed(40, 2.0, 0.0, 0.0)]
    events += [placed(4, track="ballistic", origin=25), placed(5, track="ballistic", origin=30), placed(6, track="ballistic_torque_free", origin=45)]
    s = started("gravity changes", events, tick=50, gravity=[9.0, 9.0, 9.0])
    s.get(s.watermark(52))
    changed = s.event(gravity_changed(55, 0.0, 0.0, 7.0))
    s.control(changed)
    s.get(s.packet(54, s.keyframe(0, 2), kind=0), s.packet(54, s.keyframe(1, 4)))
    s.get(s.packet(55, s.keyframe(4, 2)), s.watermark(58))
    s.control(s.event(gravity_changed(60, 1.0, 1.0, 0.0)))
    s.control(s.event(gravity_changed(60, -1.0, 0.0, 3.0)))
    s.get(s.packet(60, s.keyframe(5, 2), s.corrected(0, 60, "world", 2)), s.packet(61, s.corrected(1, 61, "world", 3)), s.watermark(70), s.checksum(70))
    s.get(s.packet(1070, s.corrected(5, 1070), s.corrected(4, 1070)))
    plain = [s]
    t = started("the gravity of Joined", bodies(3, track="ballistic"), tick=50, gravity=[3.0, 0.0, 0.0])
    t.get(t.watermark(55))
    t.control(t.event(gravity_changed(52, 0.0, 8.0, 0.0)))
    t.get(t.packet(56, t.keyframe(0, 2), t.corrected(1, 56, "world", 2)), t.watermark(60), t.checksum(60))
    return [*plain, t]


def shapes():
    """6.1-4, RECKONING 4.5"""
    own = [0.0, 0.0, 0.0, 1.0]
    points = [[0.5, 0.0, 0.25], [-0.5, 0.25, 0.0], [0.0, 0.75, -0.5], [0.0, -0.5, -0.25], [0.25, 0.25, 1.0]]
    parts = [[[0.5, 1.0, -0.25], "ball", {"radius": 0.375}], [[-2.0, 0.0, 0.5], "capsule", {"half height": 0.5, "radius": 0.25}]]
    shapes = [
        {"is": "capsule", "half height": digits(0.75), "radius": digits(0.3)},
        {"is": "cylinder", "half height": digits(0.4), "radius": digits(0.7)},
        {"is": "hull", "points": digits(points)},
        {"is": "heights", "rows": 2, "columns": 4, "row spacing": digits(1.5), "column spacing": digits(0.5), "edges": {"is": "smooth"}, "heights": digits([0.1, 0.2, -0.6, 0.3, 0.0, 0.5, -0.2, 0.9])},
        # The farthest point is in no triangle.
        {"is": "mesh", "point count": 5, "triangle count": 1, "edges": {"is": "plain"}, "points": digits(points), "triangles": [{"a": 0, "b": 1, "c": 2}]},
        {"is": "compound", "parts": [{"position": digits(at), "rotation": digits(own), "shape": {"is": kind} | {name: digits(one) for name, one in extents.items()}} for at, kind, extents in parts]},
        {"is": "compound", "parts": []},
        {"is": "rounded cuboid", "half extents": digits([0.5, 0.75, 0.25]), "radius": digits(0.3)},
        # Of the first cone the rim of the base is farther than the tip, of the second one the tip.
        {"is": "cone", "half height": digits(0.4), "radius": digits(0.9)},
        {"is": "cone", "half height": digits(0.9), "radius": digits(0.4)},
        {"is": "half-space", "normal": digits([0.0, 1.0, 0.0])},
        {"is": "cuboid", "half extents": digits([0.3, 0.7, 0.2])},
        {"is": "ball", "radius": digits(0.7)},
    ]
    events = [{"is": "ShapeAdded", "id": 2 + place, "shape": shape} for place, shape in enumerate(shapes)]
    count = len(shapes)
    s = started("shapes of each kind", [*events, *[placed(index, kind=2, shape=2 + index) for index in range(count)]])
    s.get(s.packet(1, *[s.corrected(index, 1, "world", 1, moved=True) for index in range(count)]))
    s.get(s.packet(3, *[s.corrected(index, 3) for index in range(count)]), s.checksum(4))
    return s


def full_stream():
    """5.12, 6.10-1, 6.10-3, 6.10-4"""
    s = started("a full stream", bodies(5), choice={"is": "full"}, publish_interval=2)
    s.get(s.full(2, 0, 1, kind=4), s.full(2, 2, 3, 4))
    first, second = s.full(4, 0, 1, 2, kind=4), s.full(4, 3, 4)
    s.get(second, first, first)
    s.full(6, 0, 1, 2)
    s.get(s.full(8, 1, 2, 3, 9), s.watermark(8), *s.refresh(4, 8))
    old, new = s.full(10, 0, 4), s.full(12, 0, 1)
    s.get(new, old, s.watermark(14))
    s.control(s.event(removed(1)))
    s.get(s.full(16, 0, 1), s.watermark(18))
    return s


def lost_touch():
    """6.7-9, 6.7-10, 6.8-6"""
    streams = []
    for name, least in (("1024 packets behind", 0), ("1025 packets behind", 1)):
        s = started(name, bodies(2))
        s.get(s.packet(1, s.corrected(0, 1)), s.watermark(2, next=2))
        s.number = 1025 + least
        s.get(s.packet(3, s.keyframe(0, 1), number=1024 + least, checked=False), s.watermark(4))
        streams.append(s)
    for name, far in (("a watermark behind 1025 packets", 1026), ("a watermark behind 1024 packets", 1025)):
        s = started(name, bodies(2))
        s.get(s.packet(1, s.corrected(0, 1)), s.watermark(2, next=far), s.watermark(3, next=far), s.packet(4, s.keyframe(1, 1), number=far, checked=False))
        streams.append(s)
    for name, jump in (("3600 ticks ahead", 3600), ("3601 ticks ahead", 3601)):
        for kind in ("packet", "watermark", "refresh"):
            s = started(f"a {kind} {name}", bodies(2))
            s.get(s.packet(10, s.corrected(0, 10)))
            s.packet(11, s.corrected(1, 11), checked=False)
            ahead = {"packet": [s.packet(10 + jump, s.keyframe(0, 1), checked=False)], "watermark": [s.watermark(10 + jump)], "refresh": s.refresh(1, 10 + jump, bodies=[0])}
            s.get(*ahead[kind], s.watermark(12), s.watermark(11 + jump))
            streams.append(s)
    return streams


def low_bits():
    """5.7-1"""
    s = started("numbers and ticks that overflow 16 bits", bodies(2), tick=65530, next=65533, count=65534)
    for step in range(8):
        s.get(s.packet(65531 + step, s.corrected(step % 2, 65531 + step)))
        if step in (2, 4):
            s.control(s.event(gravity_changed(65531 + step, float(step), 1.0, 0.0)))
    lost = [s.packet(65540 + step, s.corrected(step % 2, 65540 + step)) for step in range(3)]
    s.get(lost[2], lost[0], *s.refresh(s.number - 2, 65545), s.checksum(65545))
    # A late tick does not move the newest; a refresh does not either.
    s.packet(65550, s.corrected(0, 65550))
    s.get(s.packet(68000, s.keyframe(1, 1)), *s.refresh(s.number - 2, 71000), s.watermark(71600), s.watermark(71500))
    s.get(s.watermark(65000), s.packet(71550, s.keyframe(0, 1)))
    s.settle(71700)
    return s


def refused_refreshes():
    """5.11-1, 6.5-1, 6.7-8"""
    s = started("refreshes that are refused or late", bodies(4))
    s.get(s.packet(3, *[s.corrected(index, 3) for index in range(4)]))
    s.packet(4, s.corrected(0, 4), s.corrected(1, 4))
    good = s.refresh(1, 5)[0]
    negative = packets.decoded(good)
    negative["records"][1]["age"] = 6
    s.get(s.watermark(4), packets.encoded(negative), good[:-1], good + b"\x00")
    s.get(*s.refresh(9, 5, bodies=[2]), *s.refresh(0, 5, bodies=[2]), good, good)
    return s


def replaced_bodies():
    """6.1-1, 6.13-10"""
    s = started("bodies placed at an index in use", [placed(index, alias=index + 1) for index in range(3)])
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(3)]))
    s.control(s.event(placed(1, generation=1, origin=1, at=[5.0, 5.0, 5.0])))
    s.get(s.packet(2, s.corrected(2, 2)), s.packet(3, {"alias": 1, "body": None, "mode": "same", "age": 2, "position": [1, 2, 3], "turn": [0, 0, 0]}, checked=False))
    s.get(*s.refresh(s.number - 1, 4))
    s.get(s.packet(5, s.corrected(1, 5, alias=9), s.corrected(2, 5)), s.packet(6, s.corrected(1, 6)))
    s.settle(7)
    return s


def unreadable():
    """6.6-6, 6.6-10, 5.6-18"""
    s = started("packets that cannot be read", bodies(5))
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(5)]))
    # Only later packets are missing.
    wrong, after = s.packet(2, s.corrected(0, 2) | {"age": 50}, checked=False), s.packet(3, s.corrected(1, 3))
    s.get(s.packet(4, s.corrected(2, 4)), wrong, after, *s.refresh(1, 4))
    # Two updates of one packet cannot be read; the second makes it missing at once.
    s.packet(5, s.corrected(0, 5), s.corrected(3, 5, alias=8))
    past = s.refresh(4, 5)
    s.get(s.packet(6, s.corrected(0, 6), s.corrected(3, 6)), *s.refresh(5, 7), *past, s.watermark(7))
    # The parent's track is of a later tick.
    attaches = s.packet(8, s.corrected(0, 8), s.corrected(4, 8, "attached", parent=0, parent_age=0))
    s.get(s.packet(9, s.keyframe(0, 1)), attaches)
    s.settle(10)
    return s


def unknown_owners():
    """6.13-5, 6.13-6, and lines S115, S116 and S118"""
    s = started("aliases whose body is not known", [placed(index, alias=index + 1) for index in range(6)], tick=50)
    plain = {"mode": "same", "age": 50, "position": [1, 0, 0], "turn": [0, 0, 0]}
    # Of a tick before that of Joined, since which the aliases are.
    s.get(s.packet(49, {"alias": 0, "body": None} | plain | {"age": 49}, checked=False), *s.refresh(0, 50, bodies=[0]))
    s.get(s.packet(51, *[s.corrected(index, 51) for index in range(6)]))
    # A body that is not here takes no alias, and its update is ignored.
    s.get(s.packet(52, {"alias": 20, "body": 77} | plain, checked=False), s.packet(53, {"alias": 20, "body": None} | plain, checked=False), *s.refresh(s.number - 1, 53, bodies=[]))
    # An alias names none since tick 56; what was said of it before does not count any more.
    s.alias.pop(5)
    assigned, rests = s.packet(54, s.corrected(0, 54, alias=5)), s.packet(55, s.rests(0, 55))
    s.get(s.packet(56, s.corrected(1, 56, alias=5)))
    s.control(s.event(removed(1)))
    s.packet(57, s.corrected(2, 57, alias=5))
    uses = s.packet(58, s.corrected(2, 58))
    s.get(assigned, uses, rests)
    s.settle(59)
    # A body with a newer track takes no alias, but the body before loses it.
    s.alias.pop(3)
    late = s.packet(60, s.corrected(4, 60, alias=3))
    s.packet(61, s.keyframe(4, 1, alias=3))
    s.get(s.watermark(61), *s.refresh(s.number - 1, 61, without_alias=[4]), late)
    s.get(s.packet(62, s.corrected(3, 62, alias=3) | {"body": None}, checked=False), *s.refresh(s.number - 1, 62, without_alias=[3]))
    s.settle(63)
    # The update behind a later assignment could not be read; the earlier assignment does not count all the same.
    s.alias[3], s.alias[4] = 30, 31
    s.get(s.packet(64, s.corrected(3, 64, alias=30), s.corrected(4, 64, alias=31)))
    early = s.packet(65, s.corrected(4, 65, alias=32))
    s.get(s.packet(66, s.corrected(4, 66, alias=33)), early, s.packet(67, s.corrected(4, 67)))
    s.settle(68)
    # A record without an alias is older than the alias.
    s.packet(69, s.corrected(3, 69))
    s.get(s.watermark(69))
    old = s.refresh(s.number - 1, 69, without_alias=[3])
    s.get(s.packet(70, s.keyframe(3, 1, alias=40)), *old, s.packet(71, s.corrected(3, 71)))
    s.settle(72)
    return s


def far_counts():
    """5.7-1"""
    streams = []
    s = started("a count below zero", bodies(1))
    s.get(s.watermark(1, next=65535))
    streams.append(s)
    s = started("a tick at equal distance", bodies(1), tick=40000)
    s.get(s.watermark(40001), s.watermark(40001 + 32768))
    streams.append(s)
    s = started("a refresh is ahead of the newest tick", bodies(2))
    s.packet(10, s.corrected(0, 10))
    s.get(s.watermark(10), *s.refresh(0, 3000), s.watermark(4000))
    streams.append(s)
    s = started("a late packet is behind the newest tick", bodies(2))
    late = s.packet(50, s.corrected(0, 50))
    s.get(s.packet(100, s.corrected(1, 100)), late, s.watermark(3690))
    streams.append(s)
    return streams


def span():
    """6.15-3"""
    streams = []
    for name, later in (("31 numbers later", 31), ("32 numbers later", 32)):
        s = started(f"a packet is read again {name}", bodies(3))
        lost, unread = s.packet(1, s.corrected(0, 1)), s.packet(2, s.corrected(0, 2))
        s.get(unread, quiet=True)
        s.get(*[s.packet(3 + step, s.corrected(1, 3 + step)) for step in range(later)], quiet=True)
        s.get(lost)
        s.settle(40)
        streams.append(s)
    s = started("a repair symbol is ahead of the packets", bodies(3))
    lost, unread = s.packet(1, s.corrected(0, 1)), s.packet(2, s.corrected(0, 2))
    s.get(unread, quiet=True)
    rest = [s.packet(3 + step, s.corrected(1, 3 + step)) for step in range(32)]
    s.get(s.repair(0, 33, 32), *rest[:20], quiet=True)
    s.get(lost)
    s.settle(40)
    streams.append(s)
    s = started("a repair symbol of a packet that is too old", bodies(3))
    first, second = s.packet(1, s.corrected(0, 1)), s.packet(2, s.corrected(2, 2))
    s.get(s.repair(0, 0, 1), *[s.packet(3 + step, s.corrected(1, 3 + step)) for step in range(31)], quiet=True)
    s.get(second, s.watermark(34), first)
    streams.append(s)
    s = started("a repair symbol of 32 packets", bodies(3))
    sent = [s.packet(1 + step, s.corrected(step % 3, 1 + step)) for step in range(32)]
    s.get(*sent[:31], quiet=True)
    s.get(s.repair(0, *range(32)))
    streams.append(s)
    return streams


def rebuilt_ahead_of_events():
    """6.5-2, 6.6-11"""
    s = started("a rebuilt packet that waits while an earlier one comes late", bodies(4))
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(4)]))
    late = s.packet(2, s.corrected(0, 2))
    new = s.event(gravity_changed(3, 0.0, 1.0, 0.0))
    s.packet(3, s.corrected(1, 3))
    s.get(s.packet(4, s.corrected(2, 4), count=s.count - 1), s.repair(0, 2, 3), late)
    s.control(new)
    s.settle(5)
    return s


def equal_origins():
    """6.2-2, 6.7-7, 6.8-1"""
    s = started("a refresh of a track that is here, and an attachment to a removed body", bodies(4))
    s.get(s.packet(1, *[s.corrected(index, 1) for index in range(4)]))
    s.packet(2, s.corrected(0, 2), s.corrected(1, 2))
    s.get(s.packet(3, s.keyframe(0, 1), kind=0), *s.refresh(1, 4), s.watermark(2), s.watermark(4))
    s.control(s.event(removed(3)))
    s.get(s.packet(5, s.corrected(2, 5, "attached", parent=3, parent_age=4), s.corrected(0, 5)))
    s.settle(6)
    return s


def largest_packet():
    """5.8-6"""

    def filled(name, size, checked):
        s = started(name, bodies(14), largest_packet=size)
        return s, s.packet(1, *[s.keyframe(index, 1, state=True) for index in range(14)], checked=checked)

    size = len(filled("", 1150, True)[1])
    made = []
    for name, less in (("a packet of the largest size", 0), ("a packet of one byte more than the largest", 1)):
        s, data = filled(name, size - less, less == 0)
        s.get(data, s.watermark(1), s.watermark(2))
        made.append(s)
    return made


def random_stream(seed, **terms):
    """All of section 6 under loss, by chance."""
    dice = Dice(1000 + seed)
    s = started(f"by chance, {seed}", [placed(index, shape=index % 2, alias=dice.below(2) * (index + 1)) for index in range(7)], seed=seed, **terms)
    alive, generations, tick, waiting, lost = list(range(7)), dict.fromkeys(range(9), 0), 0, [], []
    for _ in range(40):
        tick += 1 + dice.below(2) * dice.below(4)
        count = 1 + dice.below(2)
        for place in range(count):
            ends = place == count - 1
            moved, fresh = [index for index in alive if dice.below(3) == 0], []
            for index in moved:
                track, roll = s.tracks.bodies[index].track, dice.below(12)
                if track.origin >= tick or (track.parent and s.tracks.parent(track) is None and roll >= 2):
                    continue
                if roll < 2:
                    fresh.append(s.keyframe(index, dice.below(6)))
                elif track.parent and (roll < 8 or track.parent[0] in moved):
                    fresh.append(s.corrected(index, tick))
                elif track.parent:
                    fresh.append(s.corrected(index, tick, "world", dice.below(5), moved=False))
                elif roll == 2:
                    parents = [other for other in alive if other not in moved and not s.tracks.bodies[other].track.parent]
                    fresh.append(s.corrected(index, tick, "attached", parent=parents[0]) if parents else s.corrected(index, tick))
                elif roll == 3:
                    fresh.append(s.rests(index, tick))
                else:
                    predictor = dice.below(6)
                    fresh.append(s.corrected(index, tick, "world", predictor, moved=predictor > 0) if roll < 8 else s.corrected(index, tick))
            data = s.packet(tick, *fresh, kind=int(ends))
            fate, number = dice.below(10), s.number - 1
            if fate < 5:
                s.get(data)
            elif fate < 8:
                waiting.append(data)
                lost.append(number)
            else:
                lost.append(number)
            if dice.below(4) == 0 and s.number > 3:
                s.get(s.repair(dice.below(128), *[number - back for back in range(min(3, number + 1 - 0)) if number - back in s.sent]))
        if dice.below(3) == 0 and waiting:
            s.get(waiting.pop(dice.below(len(waiting))))
        if dice.below(2) == 0 and lost:
            number = lost.pop(0)
            parts = s.refresh(number, tick, 1 + dice.below(2))
            s.get(*parts) if dice.below(4) else s.get(parts[0])
            if dice.below(4) == 0:
                lost.append(number)
        if dice.below(8) == 0:
            index = alive[dice.below(len(alive))]
            gone = s.event(removed(index, generations[index]))
            alive.remove(index)
            generations[index] += 1
            new = s.event(placed(index, generation=generations[index], origin=tick))
            alive.append(index)
            s.control(gone)
            s.control(new)
        if dice.below(6) == 0:
            s.get(s.checksum(tick) if dice.below(2) else s.watermark(tick))
    s.get(s.watermark(tick + 1))
    s.settle(tick + 2)
    return s


def upstreams():
    """6.14"""

    def granted(name):
        return Authority(name, [placed(0, kind=2, track="rest", origin=100), placed(1, kind=2, track="uniform", origin=100, linear=[1.0, 0.0, 0.5])], 100)

    s = granted("an upstream of two bodies")
    s.get(s.checksum(100))
    s.step(100)
    s.get(s.packet(101, s.keyframe(0, 1, linear=[1.0, 0.0, 0.0]), s.corrected(1, 101, "world", 1, moved=True)))
    s.get(s.packet(103, s.corrected(0, 103), s.corrected(1, 103, "world", 3, moved=True)), s.packet(105, s.corrected(0, 105, "world", 2, moved=True)))
    s.step(101, 102, 103, 104, 105, 106)
    s.get(s.watermark(109), s.watermark(117))
    s.step(117, 180, 193, 194, 195, 300)
    s.get(s.packet(301, s.rests(0, 301), s.corrected(1, 301)), s.checksum(302))
    s.step(301, 302, 365, 366, 367)
    refused = granted("an upstream with packets to drop")
    wrong = [
        refused.packet(101, refused.corrected(0, 101), count=1, checked=False),
        refused.packet(101, refused.corrected(0, 101, alias=512), checked=False, number=0),
        refused.packet(101, {"alias": 3, "body": 512, "keyframe": refused.keyframe(0)["keyframe"]}, checked=False, number=0),
        refused.packet(101, refused.keyframe(0, 0, parent=[1, 0], alias=0), checked=False, number=0),
        refused.packet(101, refused.corrected(0, 101, "attached", parent=1, alias=0), checked=False, number=0),
        refused.watermark(101, count=1, next=0),
    ]
    for tick, data in enumerate(wrong, 101):
        refused.get(data)
        refused.step(tick)
    refused.number, refused.tracks.next = 0, 0
    full = refused.full(107, 0)
    refused.number, refused.tracks.next = 0, 0
    refused.get(full)
    refused.get(refused.packet(108, refused.keyframe(0, 1, alias=0, at=[1.0, 1.0, 1.0])))
    refused.step(108)
    refused.get(refused.checksum(109, off=1))
    refused.step(109)
    lossy = granted("an upstream that loses packets, and touch")
    first, second = lossy.packet(101, lossy.keyframe(0, 1), lossy.corrected(1, 101, "world", 1)), lossy.packet(102, lossy.corrected(0, 102))
    lossy.get(second)
    lossy.step(102)
    lossy.get(first)
    lossy.step(103)
    lossy.packet(104, lossy.keyframe(0, 1), lossy.corrected(1, 104, "world", 0))
    lossy.get(lossy.packet(105, lossy.corrected(1, 105)), *lossy.refresh(2, 106))
    lossy.step(106)
    lossy.packet(107, lossy.keyframe(1, 1))
    lossy.get(lossy.repair(0, 4), lossy.watermark(108))
    lossy.step(108)
    lossy.get(lossy.checksum(109, off=1), lossy.packet(110, lossy.keyframe(0, 1)))
    lossy.step(110, 200)
    return [s, refused, lossy, *rule_streams.upstreams()]


def streams():
    makers = [several_packets, every_third_tick, predictors, attached, parent_becomes_attached, wrong_parents, refreshes, late_packets, ahead_of_events, many_wait]
    makers += [aliases, more_aliases, checksums, differing_checksum, budget, no_budget, redundancy, wrong_repair_symbols, many_repair_symbols, dropped_repair_symbols]
    makers += [gravities, shapes, full_stream, lost_touch, low_bits, refused_refreshes]
    makers += [replaced_bodies, unreadable, unknown_owners, far_counts, span, rebuilt_ahead_of_events, equal_origins, largest_packet]
    made = []
    for maker in makers:
        stream = maker()
        made += stream if isinstance(stream, list) else [stream]
    made += [random_stream(seed, publish_interval=1) for seed in range(6)]
    return made + rule_streams.streams()


def text(made):
    """One refused datagram and one event a line."""

    def listed(streams):
        parts = []
        for stream in streams:
            events = ",\n".join(json.dumps(event, separators=(",", ":")) for event in stream.recorded)
            parts.append(f'{{"name": {json.dumps(stream.name)}, "events": [\n{events}\n]}}')
        return "[\n" + ",\n".join(parts) + "\n]"

    lines = ",\n".join(json.dumps(line) for line in refused.lines())
    head = '{\n"format": "rhumb scripted streams 1",\n"refused": [\n' + lines + "\n],\n"
    return head + '"streams": ' + listed(made) + ',\n"upstreams": ' + listed(upstreams()) + "\n}\n"


def main():
    made = text(streams())
    if "--write" in sys.argv:
        FILE.write_text(made, encoding="utf-8")
        return 0
    same = FILE.read_text(encoding="utf-8") == made
    print("scripted.json is as it is made" if same else "scripted.json differs: python3 spec/reference/make_streams.py --write")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
