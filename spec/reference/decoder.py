"""What these files make of bytes, line by line: `rhumb-conformance vectors --exec "python3 spec/reference/decoder.py"`.

Reads a JSON object a line from standard input and answers by one; docs/implementing.md has what they say.
"""

import json
import sys

import check_messages
import check_streams
import packets
from packets import Malformed


def message(side, data):
    try:
        kind, body = check_messages.one_frame(data)
    except Malformed as why:
        return {"refused": why.args[0]}
    what, means = check_messages.outcome(side, kind, body)
    if what == "malformed":
        return {"refused": means}
    if what == "skipped":
        return {"skipped": True}
    return {"error": means} if what == "error" else {"means": means}


def packet(data):
    try:
        return {"means": packets.decoded(data)}
    except Malformed as why:
        return {"refused": why.args[0]}


def parity(question):
    covered = [(number, bytes.fromhex(data)) for number, data in question["packets"]]
    return {"bytes": packets.parity(question["row"], covered).hex()}


def stream(events):
    member, told = check_streams.Member(), []
    for what, said in events:
        if what == "control":
            member.hear_control(bytes.fromhex(said))
        elif what == "datagram" and member.scene:
            member.scene.hear_datagram(bytes.fromhex(said))
        elif what == "known":
            told.append(check_streams.known(member.scene, said["settled"]))
    return {"known": told}


def answer(question):
    if "message" in question:
        return message(question["message"], bytes.fromhex(question["bytes"]))
    if "frames" in question:
        said, refused = check_messages.split(bytes.fromhex(question["frames"]))
        return {"messages": said, "refused": refused}
    if "packet" in question:
        return packet(bytes.fromhex(question["packet"]))
    if "packets" in question:
        return parity(question)
    if "stream" in question:
        return stream(question["stream"])
    return {"unsupported": True}


def main():
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
