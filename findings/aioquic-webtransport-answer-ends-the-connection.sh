#!/usr/bin/env bash
# A client of WebTransport opens a bidirectional stream, and the server answers on it.
# PyPI aioquic 1.7.2, at both ends.
# Guess: the answer comes as an event WebTransportStreamDataReceived, as at the server.
# Seen: H3Connection does not remember that it opened the stream for a session, and reads the answer as frames of HTTP/3. An
# answer that begins with a zero is a frame DATA to it: the connection ends with H3_FRAME_UNEXPECTED (0x105). One that begins
# with 0x21, a reserved frame, is skipped without a word. A client takes the bytes before the package does, by the stream's
# number in StreamDataReceived.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet --disable-pip-version-check aioquic==1.7.2
openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=localhost \
    -keyout "$work/key.pem" -out "$work/cert.pem" 2>/dev/null
"$work/python/bin/python" - "$work" <<'PYTHON'
import asyncio
import importlib.metadata
import ssl
import sys

from aioquic.asyncio import QuicConnectionProtocol, connect, serve
from aioquic.h3.connection import H3Connection
from aioquic.h3.events import HeadersReceived, WebTransportStreamDataReceived
from aioquic.quic.configuration import QuicConfiguration
from aioquic.quic.events import ConnectionTerminated

work = sys.argv[1]
print("aioquic", importlib.metadata.version("aioquic"))


class End(QuicConnectionProtocol):
    """One end: the server accepts each session, and answers each stream with the bytes that it had."""

    def __init__(self, *args, **more):
        super().__init__(*args, **more)
        self.http = H3Connection(self._quic, enable_webtransport=True)
        self.accepted, self.answer, self.end = (asyncio.get_running_loop().create_future() for _ in range(3))

    def quic_event_received(self, event):
        if isinstance(event, ConnectionTerminated) and not self.end.done():
            self.end.set_result(event.error_code)
        for seen in self.http.handle_event(event):
            client = self._quic.configuration.is_client
            if isinstance(seen, HeadersReceived) and client:
                self.accepted.set_result(dict(seen.headers)[b":status"])
            elif isinstance(seen, HeadersReceived):
                self.http.send_headers(seen.stream_id, [(b":status", b"200")])
            elif isinstance(seen, WebTransportStreamDataReceived) and client:
                self.answer.set_result(seen.data)
            elif isinstance(seen, WebTransportStreamDataReceived):
                self._quic.send_stream_data(seen.stream_id, seen.data)
        self.transmit()


async def sent(port, message):
    """What comes of a message: its answer, a code of the connection's end, or nothing."""
    configuration = QuicConfiguration(
        is_client=True, alpn_protocols=["h3"], max_datagram_frame_size=65536, verify_mode=ssl.CERT_NONE
    )
    async with connect("127.0.0.1", port, configuration=configuration, create_protocol=End) as client:
        session = client._quic.get_next_available_stream_id()
        fields = {":method": "CONNECT", ":scheme": "https", ":authority": "localhost", ":path": "/", ":protocol": "webtransport"}
        client.http.send_headers(session, [(name.encode(), value.encode()) for name, value in fields.items()])
        client.transmit()
        assert await client.accepted == b"200"
        stream = client.http.create_webtransport_stream(session)
        client._quic.send_stream_data(stream, message)
        client.transmit()
        done, _ = await asyncio.wait([client.answer, client.end], timeout=2, return_when=asyncio.FIRST_COMPLETED)
        return next((future.result() for future in done), None)


async def main():
    configuration = QuicConfiguration(is_client=False, alpn_protocols=["h3"], max_datagram_frame_size=65536)
    configuration.load_cert_chain(f"{work}/cert.pem", f"{work}/key.pem")
    server = await serve("127.0.0.1", 0, configuration=configuration, create_protocol=End)
    port = server._transport.get_extra_info("sockname")[1]
    found = [await sent(port, message) for message in (b"\x00\x02hi", b"\x21\x02hi")]
    print("an answer that begins with a zero:", hex(found[0]) if isinstance(found[0], int) else found[0])
    print("an answer that begins with 0x21:", found[1])
    server.close()
    if found != [0x105, None]:
        raise SystemExit("changed: something else comes of an answer")
    print("as found: the client never has its answer, and the connection ends for the first one")


asyncio.run(main())
PYTHON
