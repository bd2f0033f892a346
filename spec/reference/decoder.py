"""The reference decoder as a process: `rhumb-conformance vectors --exec "python3 spec/reference/decoder.py"`.

Reads one JSON object per line from standard input and answers with one; docs/book/src/implementing.md describes them.
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


def repair_symbol(question):
    covered = [(number, bytes.fromhex(data)) for number, data in question["packets"]]
    return {"bytes": packets.repair_symbol(question["row"], covered).hex()}


def stream(events):
    member, reported = check_streams.Member(), []
    for what, value in events:
        if what == "control":
            member.receive_control(bytes.fromhex(value))
        elif what == "datagram" and member.scene:
            member.scene.receive_datagram(bytes.fromhex(value))
        elif what == "known":
            reported.append(check_streams.reported(member.scene, value))
    return {"known": reported}


def answer(question):
    if "message" in question:
        return message(question["message"], bytes.fromhex(question["bytes"]))
    if "frames" in question:
        split_messages, refused = check_messages.split(bytes.fromhex(question["frames"]))
        return {"messages": split_messages, "refused": refused}
    if "packet" in question:
        return packet(bytes.fromhex(question["packet"]))
    if "packets" in question:
        return repair_symbol(question)
    if "stream" in question:
        return stream(question["stream"])
    if "upstream" in question:
        return {"known": list(check_streams.upstream_states(question["upstream"]))}
    return {"unsupported": True}


def main():
    for line in sys.stdin:
        print(json.dumps(answer(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
