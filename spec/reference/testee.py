"""The client of client.py as one under test: `rhumb-conformance client --exec "python3 spec/reference/testee.py"`.

Told by its environment where to go and what to wish, as docs/implementing.md says; tells what its copy holds, a JSON object a
line. Exit code 127: it has not what it is ordered to do.
"""

import asyncio
import json
import os
import ssl
import sys
from dataclasses import dataclass

from aioquic.asyncio.client import connect
from aioquic.quic.configuration import QuicConfiguration

import client
import driver

UNSUPPORTED = 127


@dataclass
class Wish:
    choice: dict  # the stream that it joins
    ticks: int = 0  # up to which it asks for each
    change: dict = None  # the stream that it follows then
    drives: int = None  # within how many micrometres


def within(micrometres):
    return {"is": "within a surface tolerance", "micrometres": int(micrometres)}


def read(wish):
    """None where the wish means nothing here."""
    match wish.split(" "):
        case ["follow", "full"]:
            return Wish({"is": "full"})
        case ["follow", micrometres]:
            return Wish(within(micrometres))
        case ["follow", micrometres, "budget", rate]:
            budget = {"is": "within a budget", "bytes a second": int(rate), "bytes at once": 4000}
            return Wish(budget | {"choice": within(micrometres)})
        case ["follow", micrometres, "advance", ticks]:
            return Wish(within(micrometres), ticks=int(ticks))
        case ["follow", micrometres, "change", other]:
            return Wish(within(micrometres), change=within(other))
        case ["drive", micrometres]:
            return Wish({"is": "full"}, drives=int(micrometres))
    return None


class Told:
    """Tells of each tick at which the copy is complete, and asks for the next if that is wished."""

    def __init__(self, member, ticks):
        self.member, self.ticks, self.last, self.driver = member, ticks, None, None

    def change(self, scene):
        tell({"is": "following"})
        self.last = None

    def note(self, scene):
        for index, generation in scene.amended:
            tell({"is": "amended", "body": f"{index}:{generation}"})
        scene.amended = []
        tick = scene.complete()
        if not scene.whole or not scene.is_settled() or tick == self.last:
            return
        self.last = tick
        moving = {
            f"{index}:{body.generation}": client.bits(scene.believed(body, tick))
            for index, body in sorted(scene.bodies.items())
            if not body.track.is_verbatim_rest()
        }
        tell({"is": "tick", "tick": tick, "sum": f"{scene.sum():016x}", "moving": moving})
        if tick < self.ticks:
            self.member.advance(tick + 1)
        if self.driver:
            self.driver.go_on(tick)


def tell(line):
    print(json.dumps(line), flush=True)


async def follow(wish):
    host, port = os.environ["RHUMB_ADDR"].rsplit(":", 1)
    configuration = QuicConfiguration(is_client=True, alpn_protocols=["rhumb/1"], verify_mode=ssl.CERT_NONE)
    configuration.max_datagram_frame_size, configuration.idle_timeout = 65536, 10.0
    async with connect(host.strip("[]"), int(port), configuration=configuration, create_protocol=client.Member) as member:
        member.must_be(os.environ["RHUMB_FINGERPRINT"].lower())
        told = Told(member, wish.ticks)
        member.on_state, member.on_change = told.note, told.change
        greased = [{"id": 27, "value": "00"}]
        hello = {"is": "Hello", "magic": 0x424D4852, "versions": [0x4A4A, 1], "scene": os.environ["RHUMB_SCENE"]}
        member.say(hello | {"extensions": greased})
        try:
            welcome = await member.answer("Welcome")
            if welcome["version"] != 1:
                member.end(client.VERSION)
            else:
                member.say({"is": "Join", "choice": wish.choice})
                await member.answer("SnapshotEnd")
                tell({"is": "joined"})
                if wish.change:
                    member.say({"is": "Follow", "choice": wish.change})
                if wish.drives:
                    told.driver = driver.Driver(member, wish.drives)
                    told.driver.begin()
                    heeding = asyncio.ensure_future(told.driver.heed())
                await member.repair()
        except (client.Ended, asyncio.TimeoutError):
            pass
        tell({"is": "ended", "code": member.ended})


def main():
    missing = [name for name in ("RHUMB_ADDR", "RHUMB_FINGERPRINT", "RHUMB_SCENE", "RHUMB_WISH") if name not in os.environ]
    if missing:
        sys.exit(f"error: not told {', '.join(missing)}: rhumb-conformance starts this")
    try:
        wish = read(os.environ["RHUMB_WISH"])
    except ValueError:
        wish = None
    if wish is None:
        return UNSUPPORTED
    try:
        asyncio.run(follow(wish))
    except (OSError, ValueError) as cause:
        sys.exit(f"error: {os.environ['RHUMB_ADDR']}: {str(cause) or 'no connection'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
