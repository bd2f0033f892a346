"""Compares what other software reads from the datagrams of the example `states`, and prints a table.

Usage: readers.py STATES, with the example's output. Asks tshark, PyPI opendis 1.0, npm open-dis 1.3.6 (in the present
folder's node_modules) and Maven edu.nps.moves:open-dis 5.9 (with what it needs in the folder jars), as far as they are installed.
Fields are compared with the bytes; the exit code is 1 if one differs. The other columns say what a reader makes of a
bundle, of a PDU that lacks its last four bytes, and of a length that is not that of the PDU.
"""

import glob
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


def tshark(datagrams, *arguments):
    with tempfile.NamedTemporaryFile(suffix=".pcap") as file:
        file.write(capture(datagrams))
        file.flush()
        done = subprocess.run(["tshark", "-r", file.name, *arguments], capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def by_tshark(pdus):
    names = [part for name in TSHARK for part in ("-e", name)]
    read = tshark(pdus, "-T", "fields", *names)
    return [[float(x) for x in line.split("\t")] for line in read]


JAVA = """
import edu.nps.moves.dis7.*;
import java.io.*;
import java.util.*;

class Reader {
  public static void main(String[] mode) throws Exception {
    var factory = new PduFactory();
    var lines = new BufferedReader(new InputStreamReader(System.in));
    for (String hex; (hex = lines.readLine()) != null; ) {
      byte[] bytes = HexFormat.of().parseHex(hex);
      if (mode[0].equals("bundle")) {
        System.out.println(factory.getPdusFromBundle(bytes).size());
        continue;
      }
      var p = (EntityStatePdu) factory.createPdu(bytes);
      var id = p.getEntityID();
      var v = p.getEntityLinearVelocity();
      var l = p.getEntityLocation();
      var o = p.getEntityOrientation();
      var a = p.getDeadReckoningParameters().getEntityLinearAcceleration();
      var w = p.getDeadReckoningParameters().getEntityAngularVelocity();
      var is = new Object[] {id.getSiteID(), id.getApplicationID(), id.getEntityID(), v.getX(), v.getY(), v.getZ(),
          l.getX(), l.getY(), l.getZ(), o.getPsi(), o.getTheta(), o.getPhi(), p.getEntityAppearance(),
          a.getX(), a.getY(), a.getZ(), w.getX(), w.getY(), w.getZ()};
      System.out.println(Arrays.toString(is));
    }
  }
}
"""


def java(datagrams, mode):
    text = "\n".join(data.hex() for data in datagrams)
    with tempfile.TemporaryDirectory() as folder:
        source = f"{folder}/Reader.java"
        with open(source, "w", encoding="ascii") as file:
            file.write(JAVA)
        command = ["java", "-cp", "jars/*", source, mode]
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=True)
    return [json.loads(line) for line in done.stdout.splitlines()]


def outcome(read):
    """The outcome of one datagram at a reader: the number of PDUs, or a refusal."""
    try:
        count = read()
    except Exception:  # Each exception is a refusal.
        return "refused"
    return f"{count} read" if count else "refused"


def readers():
    """Name, fields of lone PDUs, and PDUs found in a datagram."""
    if shutil.which("tshark"):
        version = subprocess.run(["tshark", "-v"], capture_output=True, text=True, check=True).stdout.split()[2]

        def found(datagram):
            if tshark([datagram], "-Y", "_ws.malformed"):
                return 0
            return len(tshark([datagram], "-T", "fields", "-e", "dis.entity_id_entity")[0].split(","))

        yield f"tshark {version.rstrip('.')}", by_tshark, found
    try:
        from opendis.PduFactory import createPdu

        yield "PyPI opendis 1.0", by_opendis, lambda datagram: int(createPdu(datagram) is not None)
    except ImportError:
        pass
    if shutil.which("node") and glob.glob("node_modules/open-dis"):
        yield "npm open-dis 1.3.6", by_node, lambda datagram: len(by_node([datagram]))
    if shutil.which("java") and glob.glob("jars/open-dis-*.jar"):
        yield (
            "Maven open-dis 5.9",
            lambda pdus: java(pdus, "fields"),
            lambda datagram: java([datagram], "bundle")[0],
        )


def compare(read, pdus):
    """The number of equal fields, to six digits, as tshark prints f32."""
    equal = total = 0
    for found, pdu in zip(read, pdus, strict=True):
        for a, b in zip(found, fields(pdu)):
            total += 1
            equal += abs(a - b) <= 1e-5 * max(1e-3, abs(b))
    return equal, total


def main():
    with open(sys.argv[1], encoding="ascii") as file:
        datagrams = file.read().split()
    pdus = list(states(datagrams))
    bundle = max((bytes.fromhex(data) for data in datagrams), key=len)
    cut, long = pdus[0][:-4], bytearray(pdus[0])
    struct.pack_into(">H", long, 8, 160)
    fine = True
    print("| reader | equal fields | PDUs of a bundle | cut by 4 bytes | length 160 of 144 |")
    print("|---|---:|---:|---|---|")
    for name, read, found in readers():
        equal, total = compare(read(pdus), pdus)
        fine &= equal == total
        inside = f"{found(bundle)} of {len(list(states([bundle.hex()])))}"
        ends = [outcome(lambda data=data: found(bytes(data))) for data in (cut, long)]
        print(f"| {name} | {equal} of {total} | {inside} | {ends[0]} | {ends[1]} |")
    sys.exit(not fine)


main()
