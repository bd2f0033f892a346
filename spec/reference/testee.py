"""client.py as a client under test: `rhumb-conformance client --exec "python3 spec/reference/testee.py"`.

The environment gives its server and its task, as docs/book/src/implementing.md describes; it reports the state of its copy, one
JSON object per line. Exit code 127: the task is unsupported.
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
import authority

UNSUPPORTED = 127


@dataclass
class Task:
    choice: dict  # the stream that it joins first
    ticks: int = 0  # the last tick that it requests
    change: dict = None  # the stream that it changes to
    upstream_micrometres: int = None  # tolerance of the upstream in micrometres


def within(micrometres):
    return {"is": "within a surface tolerance", "micrometres": int(micrometres)}


def read(task):
    """The parsed task; None if it is unknown."""
    match task.split(" "):
        case ["subscribe", "full"]:
            return Task({"is": "full"})
        case ["subscribe", micrometres]:
            return Task(within(micrometres))
        case ["subscribe", micrometres, "budget", rate]:
            budget = {"is": "within a budget", "rate": int(rate), "burst": 4000}
            return Task(budget | {"choice": within(micrometres)})
        case ["subscribe", micrometres, "advance", ticks]:
            return Task(within(micrometres), ticks=int(ticks))
        case ["subscribe", micrometres, "change", other]:
            return Task(within(micrometres), change=within(other))
        case ["upstream", micrometres]:
            return Task({"is": "full"}, upstream_micrometres=int(micrometres))
    return None


class Report:
    """Reports each complete tick, and requests the next one if the task says so."""

    def __init__(self, member, ticks):
        self.member, self.ticks, self.last, self.authority = member, ticks, None, None

    def change(self, scene):
        write_line({"is": "following"})
        self.last = None

    def note(self, scene):
        tick = scene.complete()
        if not scene.has_snapshot or not scene.is_converged() or tick == self.last:
            return
        self.last = tick
        moving = {
            f"{index}:{body.generation}": client.bits(scene.predicted_motion(body, tick))
            for index, body in sorted(scene.bodies.items())
            if not body.track.is_exact_rest()
        }
        write_line({"is": "tick", "tick": tick, "checksum": f"{scene.sum():016x}", "moving": moving})
        if tick < self.ticks:
            self.member.advance(tick + 1)
        if self.authority:
            self.authority.publish_next(tick)


def write_line(line):
    print(json.dumps(line), flush=True)


async def subscribe(task):
    host, port = os.environ["RHUMB_ADDR"].rsplit(":", 1)
    configuration = QuicConfiguration(is_client=True, alpn_protocols=["rhumb/1"], verify_mode=ssl.CERT_NONE)
    configuration.max_datagram_frame_size, configuration.idle_timeout = 65536, 10.0
    async with connect(host.strip("[]"), int(port), configuration=configuration, create_protocol=client.Member) as member:
        member.must_be(os.environ["RHUMB_FINGERPRINT"].lower())
        report = Report(member, task.ticks)
        member.on_state, member.on_change = report.note, report.change
        greased = client.extensions(os.environ.get("RHUMB_TOKEN"))
        hello = {"is": "Hello", "magic": 0x424D4852, "versions": [0x4A4A, 1], "scene": os.environ["RHUMB_SCENE"]}
        member.send_message(hello | {"extensions": greased})
        try:
            welcome = await member.answer("Welcome")
            if welcome["version"] != 1:
                member.end(client.VERSION)
            else:
                member.send_message({"is": "Join", "choice": task.choice})
                await member.answer("SnapshotEnd")
                write_line({"is": "joined"})
                if task.change:
                    member.send_message({"is": "Subscribe", "choice": task.change})
                if task.upstream_micrometres:
                    report.authority = authority.Authority(member, task.upstream_micrometres)
                    report.authority.begin()
                    answers = asyncio.ensure_future(report.authority.handle_answers())
                await member.refresh()
        except (client.Ended, asyncio.TimeoutError):
            pass
        write_line({"is": "ended", "code": member.ended})


def main():
    missing = [name for name in ("RHUMB_ADDR", "RHUMB_FINGERPRINT", "RHUMB_SCENE", "RHUMB_TASK") if name not in os.environ]
    if missing:
        sys.exit(f"error: {', '.join(missing)} missing; rhumb-conformance starts this program")
    try:
        task = read(os.environ["RHUMB_TASK"])
    except ValueError:
        task = None
    if task is None:
        return UNSUPPORTED
    try:
        asyncio.run(subscribe(task))
    except (OSError, ValueError) as cause:
        sys.exit(f"error: {os.environ['RHUMB_ADDR']}: {str(cause) or 'no connection'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
