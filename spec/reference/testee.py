"""The client of client.py as one under test: `rhumb-conformance client --exec "python3 spec/reference/testee.py"`.

Told by its environment where to go and what to wish, as docs/implementing.md says; tells what its copy holds, a JSON object a
line. Exit code 127: it has not what it is ordered to do.
"""

import asyncio
import json
import os
import ssl
import sys

from aioquic.asyncio.client import connect
from aioquic.quic.configuration import QuicConfiguration

import client

UNSUPPORTED = 127


def choice_of(wish):
    """The stream that is wished for; None where the wish means nothing here."""
    words = wish.split(" ")
    if words[0] != "follow" or len(words) not in (2, 4):
        return None
    if words[1] == "full":
        return {"is": "full"} if len(words) == 2 else None
    within = {"is": "within a surface tolerance", "micrometres": int(words[1])}
    # No ticks are asked for here, and no stream is changed.
    return within if len(words) == 2 else None


class Told:
    """Tells of each tick at which the copy is complete."""

    def __init__(self):
        self.last = None

    def note(self, scene):
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


def tell(line):
    print(json.dumps(line), flush=True)


async def follow(choice):
    host, port = os.environ["RHUMB_ADDR"].rsplit(":", 1)
    configuration = QuicConfiguration(is_client=True, alpn_protocols=["rhumb/1"], verify_mode=ssl.CERT_NONE)
    configuration.max_datagram_frame_size, configuration.idle_timeout = 65536, 10.0
    async with connect(host.strip("[]"), int(port), configuration=configuration, create_protocol=client.Member) as member:
        member.must_be(os.environ["RHUMB_FINGERPRINT"].lower())
        member.on_state = Told().note
        greased = [{"id": 27, "value": "00"}]
        hello = {"is": "Hello", "magic": 0x424D4852, "versions": [0x4A4A, 1], "scene": os.environ["RHUMB_SCENE"]}
        member.say(hello | {"extensions": greased})
        try:
            welcome = await member.answer("Welcome")
            if welcome["version"] != 1:
                member.end(client.VERSION)
            else:
                member.say({"is": "Join", "choice": choice})
                await member.answer("SnapshotEnd")
                tell({"is": "joined"})
                await member.repair()
        except (client.Ended, asyncio.TimeoutError):
            pass
        tell({"is": "ended", "code": member.ended})


def main():
    choice = choice_of(os.environ["RHUMB_WISH"])
    if choice is None:
        return UNSUPPORTED
    asyncio.run(follow(choice))
    return 0


if __name__ == "__main__":
    sys.exit(main())
