"""A client that joins a scene over QUIC (PROTOCOL 1 and 3), reports its losses, and keeps the connection alive.

Needs `aioquic`. Usage: python3 client.py --server HOST:PORT --fingerprint HEX --scene NAME --micrometres N --out FILE
[--until TICK] [--token FILE]. Prints `joined` after the snapshot, and writes the bits of each complete tick.
"""

import argparse
import asyncio
import hashlib
import json
import ssl
import struct
import sys
from pathlib import Path

from aioquic.asyncio.client import connect
from aioquic.asyncio.protocol import QuicConnectionProtocol
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.events import ConnectionTerminated, DatagramFrameReceived, StreamDataReceived
from cryptography.hazmat.primitives.serialization import Encoding

import messages
import packets
import subscriber

FIRST_LOSS_REPORT, LAST_LOSS_REPORT, SILENCE = 0.025, 0.5, 3.0
FIRST_AWAITED, LAST_AWAITED = 0.1, 2.0
DONE, MALFORMED, VIOLATION, VERSION, EXTENSION = 0, 1, 2, 3, 5


class Ended(Exception):
    """The connection is over; the argument is the close code, or a reason."""


class Member(QuicConnectionProtocol):
    """One connection about one scene."""

    def __init__(self, *arguments, **named):
        super().__init__(*arguments, **named)
        self.frames, self.scene, self.ended = messages.Frames(), None, None
        self.received, self.answers = asyncio.Event(), asyncio.Queue()
        self.on_state = lambda scene: None
        self.on_change = lambda scene: None
        self.control, self.coming, self.is_welcomed, self.is_resyncing = None, None, False, False
        self.asked_at, self.loss_report_interval, self.received_at = 0.0, FIRST_LOSS_REPORT, 0.0
        self.awaited, self.awaited_at, self.awaited_for = 0, 0.0, FIRST_AWAITED
        self.timed, self.took = None, (0.0, 0.0)  # a requested tick and the time of the request; durations of the last two
        self.asked_coming_at = 0.0

    # Receiving

    def quic_event_received(self, event):
        self.received_at = self._loop.time()
        if isinstance(event, StreamDataReceived):
            self.receive_control(event.data)
        elif isinstance(event, DatagramFrameReceived):
            for scene in filter(None, (self.scene, self.coming)):
                scene.receive_datagram(event.data)
            self.go_on()
        elif isinstance(event, ConnectionTerminated):
            self.ended = event.error_code
            self.answers.put_nowait({"is": "Ended", "code": event.error_code})

    def receive_control(self, data):
        self.frames.push(data)
        try:
            while (message := self.frames.next()) is not None:
                msg = messages.decoded("server", *message)
                if msg is not None:
                    self.receive(msg)
        except packets.Malformed:
            self.end(MALFORMED)
        except subscriber.Violation as why:
            self.end(why.args[0])

    def receive(self, msg):
        if msg["is"] in ("Welcome", "Joined") and any(one["id"] % 2 == 0 for one in msg["extensions"]):
            self.end(EXTENSION)
            return
        if msg["is"] in ("Welcome", "Joined"):
            self.check_opening(msg)
        if msg["is"] == "Welcome":
            if self.is_welcomed:
                raise subscriber.Violation(VIOLATION)
            self.is_welcomed = True
            self.answers.put_nowait(msg)
        elif msg["is"] == "Joined":
            self.must(self.is_welcomed)
            # The snapshot of another stream (4.8, 4.12), requested or not; the present stream continues until it is complete.
            if self.scene is None or self.is_resyncing:
                self.scene, self.coming, self.is_resyncing = subscriber.Scene(msg), None, False
            else:
                self.coming = subscriber.Scene(msg)
        elif msg["is"] == "SceneEvent":
            # Events of a snapshot belong to the new stream; later ones belong to both.
            scenes = [self.coming] if self.coming and not self.coming.has_snapshot else [self.scene, self.coming]
            self.must(any(scenes))
            for scene in filter(None, scenes):
                scene.receive_scene_event(msg["event"])
            self.go_on()
        else:
            if msg["is"] == "SnapshotEnd":
                filled = self.coming or self.scene
                self.must(filled and not filled.has_snapshot)
                filled.end_snapshot()
                self.go_on()
            self.answers.put_nowait(msg)

    def must(self, good):
        """3.2-4 to 3.2-6"""
        if not good:
            raise subscriber.Violation(VIOLATION)

    def go_on(self):
        """Reacts to received data."""
        coming = self.coming
        if self.timed and self.timed[0] <= self.scene.complete():
            self.took, self.timed = (self._loop.time() - self.timed[1], self.took[0]), None
        if coming and coming.has_snapshot and (coming.complete() >= self.scene.complete() or self.scene.lost_sync):
            # 4.8-12
            self.scene, self.coming = coming, None
            self.send_message({"is": "Subscribed", "stream": coming.stream})
            self.on_change(coming)
        self.on_state(self.scene)

    def check_opening(self, msg):
        """4.3-2: a configuration outside section 7 ends the connection."""
        if "config" in msg:
            try:
                messages.check_config(msg["config"])
            except messages.Refused as why:
                raise subscriber.Violation(VIOLATION) from why

    # Sending

    def send_message(self, msg):
        if self.control is None:
            self.control = self._quic.get_next_available_stream_id()
        self._quic.send_stream_data(self.control, messages.encoded("client", msg))
        self.transmit()

    def send(self, msg):
        self._quic.send_datagram_frame(packets.encoded(msg))
        self.transmit()

    def send_upstream(self, msg):
        """6.14-8: in a lockstep scene, upstream packets are control messages."""
        self.send_message({"is": "Upstream", "packet": packets.encoded(msg).hex()})

    def advance(self, tick):
        self.awaited, self.awaited_at = tick, self._loop.time()
        self.awaited_for = min(max(FIRST_AWAITED, 2 * min(self.took)), LAST_AWAITED)
        self.timed = self.timed or (tick, self.awaited_at)
        self.send_message({"is": "Advance", "tick": tick})

    def end(self, code):
        self._quic.close(error_code=code)
        self.transmit()

    async def answer(self, *names):
        """The next message of one of these names."""
        while True:
            msg = await asyncio.wait_for(self.answers.get(), 10)
            if msg["is"] in names:
                return msg
            if msg["is"] in ("Ended", "Denied"):
                raise Ended(msg)

    async def refresh(self):
        """6.7, 6.12: sends loss reports for missing packets and silent streams, and asks for a new snapshot after lost sync."""
        while self.ended is None:
            await asyncio.sleep(0.005)
            now, scene = self._loop.time(), self.scene
            if scene is None or not scene.has_snapshot:
                continue
            if scene.lost_sync:
                # 6.7-10: one request; the present copy is not updated any more.
                if not self.is_resyncing:
                    self.is_resyncing = True
                    self.send_message({"is": "Resync", "cause": int(scene.checksum_mismatches > 0)})
                continue
            if not scene.missing:
                self.loss_report_interval = FIRST_LOSS_REPORT
            silent = now - max(self.received_at, self.asked_at) > SILENCE
            if silent or (scene.missing and now - self.asked_at > self.loss_report_interval):
                self.send(scene.loss_report())
                self.asked_at, self.loss_report_interval = now, min(2 * self.loss_report_interval, LAST_LOSS_REPORT)
            elif scene.complete() < self.awaited and now - self.awaited_at > self.awaited_for:
                self.send(scene.loss_report())
                self.awaited_at, self.awaited_for = now, min(2 * self.awaited_for, LAST_AWAITED)
            if self.coming and self.coming.has_snapshot and self.coming.missing and now - self.asked_coming_at > LAST_LOSS_REPORT:
                self.send(self.coming.loss_report())
                self.asked_coming_at = now

    # 1.3

    def must_be(self, fingerprint):
        certificate = self._quic.tls._peer_certificate
        if hashlib.sha256(certificate.public_bytes(Encoding.DER)).hexdigest() != fingerprint:
            raise Ended("the server has another certificate")


def extensions(token):
    """A greased extension (3.5), and the token that a server asks for (3.6-1)."""
    shown = [{"id": 1, "value": token.strip().encode("ascii").hex()}] if token else []
    return shown + [{"id": 27, "value": "00"}]


def bits(motion):
    return "".join(struct.pack(">d", number).hex() for number in motion.numbers())


class Log:
    """Writes the state of a copy at each complete tick."""

    def __init__(self, path):
        self.file, self.written = open(path, "w", encoding="utf-8"), None

    def note(self, scene):
        tick = scene.complete()
        if not scene.is_converged() or tick == self.written:
            return
        self.written = tick
        moving = {
            f"{index}:{body.generation}": bits(scene.predicted_motion(body, tick))
            for index, body in sorted(scene.bodies.items())
            if not body.track.is_exact_rest()
        }
        line = {"is": "tick", "tick": tick, "checksum": f"{scene.sum():016x}", "moving": moving}
        self.file.write(json.dumps(line) + "\n")


async def subscribe(arguments):
    host, port = arguments.server.rsplit(":", 1)
    configuration = QuicConfiguration(is_client=True, alpn_protocols=["rhumb/1"], verify_mode=ssl.CERT_NONE)
    configuration.max_datagram_frame_size, configuration.idle_timeout = 65536, 10.0
    log = Log(arguments.out)
    async with connect(host.strip("[]"), int(port), configuration=configuration, create_protocol=Member) as member:
        member.must_be(arguments.fingerprint.lower())
        member.on_state = log.note
        # A greased version and a greased extension are offered too (3.5).
        hello = {"is": "Hello", "magic": 0x424D4852, "versions": [0x4A4A, 1], "scene": arguments.scene}
        member.send_message(hello | {"extensions": extensions(arguments.token)})
        welcome = await member.answer("Welcome")
        if welcome["version"] != 1:
            member.end(VERSION)
            raise Ended(VERSION)
        within = {"is": "within a surface tolerance", "micrometres": arguments.micrometres}
        member.send_message({"is": "Join", "choice": within})
        await member.answer("SnapshotEnd")
        print("joined", flush=True)
        refreshing = asyncio.ensure_future(member.refresh())
        end = asyncio.get_running_loop().time() + arguments.seconds
        while (log.written or 0) < arguments.until:
            if member.ended is not None or asyncio.get_running_loop().time() > end:
                raise Ended(member.ended if member.ended is not None else "the time limit is exceeded")
            await asyncio.sleep(0.02)
        refreshing.cancel()
        log.file.close()
        print(f"followed to tick {log.written}; checksums that differ: {member.scene.checksum_mismatches}", flush=True)
        member.send_message({"is": "Leave"})
        await member.answer("Left")
        member.end(DONE)
    return 1 if member.scene.checksum_mismatches else 0


def main():
    parser = argparse.ArgumentParser(description="Subscribes to a scene.")
    parser.add_argument("--server", required=True)
    parser.add_argument("--fingerprint", required=True)
    parser.add_argument("--scene", required=True)
    parser.add_argument("--micrometres", type=int, default=50000)
    parser.add_argument("--until", type=int, required=True, help="the tick to subscribe to")
    parser.add_argument("--seconds", type=float, default=120, help="time limit")
    parser.add_argument("--out", required=True)
    parser.add_argument("--token", type=lambda path: Path(path).read_text(encoding="ascii"), help="file with a token")
    return asyncio.run(subscribe(parser.parse_args()))


if __name__ == "__main__":
    sys.exit(main())
