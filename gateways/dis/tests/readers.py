"""Compares what other software reads from the datagrams of the example `states`.

Usage: readers.py STATES, with the example's output. Asks tshark, PyPI opendis 1.0 and npm open-dis 1.3.6 (in the present
folder's node_modules), as far as they are installed. Fields are compared with the bytes; the exit code is 1 if one differs.
"""

import io
import json
import shutil
import struct
import subprocess
import sys
import tempfile


def states(lines):
    """Each PDU, split by its own length field."""
    for line in lines:
        datagram = bytes.fromhex(line)
        while datagram:
            length = struct.unpack_from(">H", datagram, 8)[0]
            yield datagram[:length]
            datagram = datagram[length:]


def fields(pdu):
    """The numbers that are compared, from fixed places of the bytes."""
    return [
        *struct.unpack_from(">3H", pdu, 12),
        *struct.unpack_from(">3f", pdu, 36),
        *struct.unpack_from(">3d", pdu, 48),
        *struct.unpack_from(">3f", pdu, 72),
        struct.unpack_from(">I", pdu, 84)[0],
        *struct.unpack_from(">3f", pdu, 104),
        *struct.unpack_from(">3f", pdu, 116),
    ]


def by_opendis(pdus):
    from opendis.PduFactory import createPdu

    for pdu in pdus:
        read = createPdu(pdu)
        vectors = [
            (read.entityLinearVelocity, "xyz"),
            (read.entityLocation, "xyz"),
            (read.entityOrientation, ("psi", "theta", "phi")),
        ]
        reckoning = read.deadReckoningParameters
        ids = read.entityID
        yield [
            *(getattr(ids, name) for name in ids_of(ids)),
            *(getattr(vector, axis) for vector, axes in vectors for axis in axes),
            read.entityAppearance,
            *(getattr(reckoning.entityLinearAcceleration, axis) for axis in "xyz"),
            *(getattr(reckoning.entityAngularVelocity, axis) for axis in "xyz"),
        ]


def ids_of(ids):
    return [name for name in ("siteID", "applicationID", "entityID") if hasattr(ids, name)]


NODE = """
// Its own global is named dis.
const openDis = require("open-dis");
const factory = new openDis.PduFactory();
for (const hex of require("fs").readFileSync(0, "utf8").trim().split("\\n")) {
  const bytes = Uint8Array.from(Buffer.from(hex, "hex"));
  const p = factory.createPdu(bytes.buffer), d = p.deadReckoningParameters;
  const xyz = (v) => [v.x, v.y, v.z], o = p.entityOrientation;
  console.log(JSON.stringify([p.entityID.site, p.entityID.application, p.entityID.entity,
    ...xyz(p.entityLinearVelocity), ...xyz(p.entityLocation), o.psi, o.theta, o.phi, p.entityAppearance,
    ...xyz(d.entityLinearAcceleration), ...xyz(d.entityAngularVelocity)]));
}
"""


def by_node(pdus):
    text = "\n".join(pdu.hex() for pdu in pdus)
    done = subprocess.run(["node", "-e", NODE], input=text, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def capture(datagrams):
    """A pcap file with each datagram in UDP to port 3000."""
    file = io.BytesIO()
    file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 101))
    for data in datagrams:
        udp = struct.pack(">HHHH", 3000, 3000, 8 + len(data), 0) + data
        ip = struct.pack(">BBHHHBBHII", 0x45, 0, 20 + len(udp), 0, 0, 64, 17, 0, 0x7F000001, 0x7F000001)
        file.write(struct.pack("<IIII", 0, 0, len(ip + udp), len(ip + udp)) + ip + udp)
    return file.getvalue()


TSHARK = [
    "dis.entity_id_site", "dis.entity_id_application", "dis.entity_id_entity",
    *(f"dis.entity_linear_velocity.{axis}" for axis in "xyz"),
    *(f"dis.entity_location.{axis}" for axis in "xyz"),
    *(f"dis.entity_orientation.{angle}" for angle in ("psi", "theta", "phi")),
]


def by_tshark(pdus):
    with tempfile.NamedTemporaryFile(suffix=".pcap") as file:
        file.write(capture(pdus))
        file.flush()
        ask = ["tshark", "-r", file.name]
        bad = subprocess.run([*ask, "-Y", "_ws.malformed"], capture_output=True, text=True, check=True).stdout
        print(f"tshark: {len(bad.splitlines())} malformed of {len(pdus)}")
        names = [part for name in TSHARK for part in ("-e", name)]
        done = subprocess.run([*ask, "-T", "fields", *names], capture_output=True, text=True, check=True)
    return [[float(x) for x in line.split("\t")] for line in done.stdout.splitlines()]


def compare(name, read, pdus):
    """Prints a row: how many fields are equal, to six digits, as tshark prints f32."""
    equal = total = 0
    for found, pdu in zip(read, pdus, strict=True):
        for a, b in zip(found, fields(pdu)):
            total += 1
            equal += abs(a - b) <= 1e-5 * max(1e-3, abs(b))
    print(f"{name}: {len(pdus)} PDUs, {equal} of {total} fields equal")
    return equal == total


def main():
    with open(sys.argv[1], encoding="ascii") as file:
        pdus = list(states(file.read().split()))
    fine = True
    if shutil.which("tshark"):
        fine &= compare("tshark", by_tshark(pdus), pdus)
    try:
        fine &= compare("opendis", list(by_opendis(pdus)), pdus)
    except ImportError:
        print("opendis is not installed")
    if shutil.which("node"):
        fine &= compare("open-dis", by_node(pdus), pdus)
    sys.exit(not fine)


main()
