"""A client of aioquic: one trial of a server, as `run` asks for it; prints what it saw as JSON.

Usage: client.py TRIAL ADDRESS HASH MESSAGES-AS-JSON
"""

import asyncio
import hashlib
import json
import ssl
import sys

from aioquic.asyncio import QuicConnectionProtocol, connect
from aioquic.h3.connection import H3Connection
from aioquic.h3.events import DatagramReceived, DataReceived, HeadersReceived
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.events import StreamDataReceived
from cryptography.hazmat.primitives.serialization import Encoding


class Client(QuicConnectionProtocol):
    """One session."""

    def __init__(self, *args, **more):
        super().__init__(*args, **more)
        self.http = H3Connection(self._quic, enable_webtransport=True)
        self.status, self.protocol = asyncio.Future(), None
        self.control, self.datagram, self.closed = asyncio.Queue(), asyncio.Future(), asyncio.Future()
        self.capsules, self.held, self.stream = b"", b"", None

    def quic_event_received(self, event):
        # The package takes what comes back on a stream that it opened for frames of HTTP/3.
        if isinstance(event, StreamDataReceived) and event.stream_id == self.stream:
            self.control.put_nowait(event.data)
            return
        for seen in self.http.handle_event(event):
            if isinstance(seen, HeadersReceived):
                fields = dict(seen.headers)
                self.protocol = fields.get(b"wt-protocol", b"").decode()
                self.status.set_result(int(fields[b":status"]))
            elif isinstance(seen, DatagramReceived) and not self.datagram.done():
                self.datagram.set_result(seen.data)
            elif isinstance(seen, DataReceived):
                self.capsules += seen.data
                # The capsule that closes a session: its type, its length, a code.
                if self.capsules[:2] == b"\x68\x43" and len(self.capsules) >= 7 and not self.closed.done():
                    self.closed.set_result(int.from_bytes(self.capsules[3:7], "big"))

    async def message(self):
        """The type of the next message."""
        length, shift = 0, 0

        async def byte():
            while not self.held:
                self.held = await self.control.get()
            first, self.held = self.held[0], self.held[1:]
            return first

        while True:
            one = await byte()
            length |= (one & 0x7F) << shift
            shift += 7
            if one < 0x80:
                break
        message = [await byte() for _ in range(length)]
        # A type from 0x80 on is of a later version, and means nothing to this one.
        return message[0] if message[0] < 0x80 else await self.message()


async def attempt(client, trial, address, sent, saw):
    """One trial on an open connection."""
    certificate = client._quic.tls._peer_certificate.public_bytes(Encoding.DER)
    if hashlib.sha256(certificate).hexdigest() != sys.argv[3]:
        raise ValueError("another certificate")
    origin = "https://pages.example" if trial == "origin" else "http://localhost"
    session = client._quic.get_next_available_stream_id()
    fields = {
        ":method": "CONNECT", ":scheme": "https", ":authority": address, ":protocol": "webtransport",
        ":path": "/rhumb/2" if trial == "path" else "/rhumb/1", "origin": origin, "wt-available-protocols": '"rhumb/1"',
    }
    client.http.send_headers(session, [(name.encode(), value.encode()) for name, value in fields.items()])
    client.transmit()
    saw["status"] = await client.status
    if saw["status"] != 200:
        return
    saw["protocol"] = client.protocol
    stream = client.stream = client.http.create_webtransport_stream(session)

    async def say(message):
        client._quic.send_stream_data(stream, bytes.fromhex(message))
        client.transmit()
        return await client.message()

    saw["welcome"] = await say(sent["Hello"])
    if trial == "session":
        saw["created"] = await say(sent["Create"])
        saw["joined"] = await say(sent["Join"])
        saw["datagram"] = len(await client.datagram)
        client._quic.send_stream_data(stream, bytes.fromhex(sent["Malformed"]))
        client.transmit()
        saw["closed"] = await client.closed
    else:
        # A frame of data with the capsule: type, length, code 9 and a reason.
        client.http.send_data(session, b"\x68\x43\x08" + (9).to_bytes(4, "big") + b"done", end_stream=True)
        client.transmit()
        await asyncio.sleep(1)


async def main():
    """Prints what one trial shows."""
    trial, address, _, sent = sys.argv[1:]
    host, port = address.rsplit(":", 1)
    configuration = QuicConfiguration(
        is_client=True, alpn_protocols=["h3"], max_datagram_frame_size=65536, verify_mode=ssl.CERT_NONE
    )
    saw = {}
    try:
        async with asyncio.timeout(10):
            async with connect(host, int(port), configuration=configuration, create_protocol=Client) as client:
                await attempt(client, trial, address, json.loads(sent), saw)
    except (Exception, asyncio.CancelledError) as error:
        saw["error"] = repr(error)
    print(json.dumps(saw))


asyncio.run(main())
