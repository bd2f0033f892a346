"""Runs packets.py over the golden vectors: both ways for valid packets, and the reason for refused ones.

Usage: python3 check_packets.py. Prints failures, then a count; the exit code is 1 after a failure.
"""

import json
import sys
from pathlib import Path

import packets

SPEC = Path(__file__).resolve().parent.parent


SHORT = 40  # Longest datagram whose bits are all flipped here; the Rust tests flip the bits of all.


def survives(datagram, bit):
    """True if a datagram with one bit flipped is refused, or encodes to the same bytes again."""
    flipped = bytearray(datagram)
    flipped[bit // 8] ^= 1 << bit % 8
    try:
        return packets.encoded(packets.decoded(bytes(flipped))) == flipped
    except packets.Malformed:
        return True


def outcome(datagram):
    """The meaning of a datagram, or the reason of its refusal as a word."""
    try:
        return packets.decoded(datagram)
    except packets.Malformed as why:
        return why.args[0]


def results(vectors):
    """The expected and the actual result of each case."""
    for case in vectors["accepted"]:
        datagram = bytes.fromhex(case["bytes"])
        yield case["name"], case["means"], outcome(datagram)
        yield case["name"] + ", written", case["bytes"], packets.encoded(case["means"]).hex()
        if len(datagram) <= SHORT:
            yield case["name"] + ", each bit flipped", [], [bit for bit in range(8 * len(datagram)) if not survives(datagram, bit)]
    for case in vectors["repair_symbols"]:
        covered = [(number, bytes.fromhex(datagram)) for number, datagram in case["packets"]]
        row = packets.decoded(bytes.fromhex(case["repair_symbol"]))["row"]
        yield "the repair symbol of packets", case["repair_symbol"], packets.repair_symbol(row, covered).hex()
    for case in vectors["refused"]:
        yield case["name"], case["refusal"], outcome(bytes.fromhex(case["bytes"]))


def main():
    passed, failed = 0, 0
    vectors = json.loads((SPEC / "vectors" / "packets.json").read_text(encoding="utf-8"))
    for name, want, got in results(vectors):
        passed += want == got
        failed += want != got
        if want != got:
            print(f"{name}: expected {want}, got {got}")
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
