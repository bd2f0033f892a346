"""Runs messages.py over the golden vectors of the control stream: both ways, each truncation, and what must be refused.

Usage: python3 check_messages.py. Prints failures, then a count; the exit code is 1 after a failure.
"""

import json
import sys
from pathlib import Path

import messages
from packets import Malformed

SPEC = Path(__file__).resolve().parent.parent


def one_frame(data):
    frames = messages.Frames()
    frames.push(data)
    return frames.next()


def outcome(side, kind, body):
    """The meaning of a message, with its error if it is refused; a word if it is malformed."""
    try:
        means = messages.decoded(side, kind, body)
    except Malformed as why:
        # A command with an invalid motion is refused, not malformed (2.6-29).
        in_command = side == "client" and kind == 7 and why.args[0] == "NotFinite"
        return ("error", messages.not_finite(why.args[1])) if in_command else ("malformed", why.args[0])
    except messages.UnknownCommand:
        return "error", {"is": "UnknownCommand"}
    if means is None:
        return "skipped", None
    try:
        if side == "client":
            messages.check_command(means)
    except messages.Refused as why:
        return "error", why.error
    return "accepted", means


def results(vectors):
    """The expected and the actual result of each case."""
    for side in ("client", "server"):
        for case in vectors[side + " messages"]:
            yield from accepted(side, case)
        for case in vectors["refused " + side + " messages"]:
            yield refused(side, case)
        for case in vectors["long " + side + " messages"]:
            yield long(side, case)
    for rule in messages.TABLE["rules"]:
        # The type, and perhaps one of its codes.
        kind = next((kind for kind in messages.TYPES if f"{rule['of']} ".startswith(f"{kind} ")), None)
        yield f"the rule of {rule['of']}", True, kind is not None
    for case in vectors["frames"]:
        yield case["name"], (case["messages"], "refusal" in case), split(bytes.fromhex(case["bytes"]))


def accepted(side, case):
    data, name = bytes.fromhex(case["bytes"]), case["name"]
    kind, body = one_frame(data)
    yield meaning(side, case)
    if "skipped" not in case and "error" not in case:
        yield name + ", written", data.hex(), messages.encoded(side, case["means"]).hex()
    longer = body + b"\0"
    accepted_lengths = [end for end in range(len(longer) + 1) if end != len(body) and outcome(side, kind, longer[:end])[0] != "malformed"]
    yield name + ", cut", case["cuts"], accepted_lengths


def meaning(side, case):
    """The meaning of a message that may be sent, or the error that answers it."""
    what, means = outcome(side, *one_frame(bytes.fromhex(case["bytes"])))
    if "skipped" in case:
        return case["name"], "skipped", what
    stated = ("error", case["error"]) if "error" in case else ("accepted", case["means"])
    return case["name"], stated, (what, means)


def refused(side, case):
    """One that is malformed."""
    what, _ = outcome(side, *one_frame(bytes.fromhex(case["bytes"])))
    return case["name"], "malformed", what


def long(side, case):
    """One in pieces: its body is each of the parts so many times."""
    body = b"".join(bytes.fromhex(digits) * times for digits, times in case["parts"])
    try:
        kind, joined = one_frame(messages.framed(case["type"], body))
        what, means = outcome(side, kind, joined)
    except Malformed:
        what, means = "malformed", None
    stated = "malformed" if "refusal" in case else "skipped" if "skipped" in case else case.get("error", "accepted")
    return case["name"], stated, means if what == "error" else what


def split(data):
    frames, found = messages.Frames(), []
    frames.push(data)
    while True:
        try:
            message = frames.next()
        except Malformed:
            return found, True
        if message is None:
            return found, False
        found.append({"type": message[0], "body": message[1].hex()})


def main():
    passed, failed = 0, 0
    vectors = json.loads((SPEC / "vectors" / "control.json").read_text(encoding="utf-8"))
    for name, want, got in results(vectors):
        passed += want == got
        failed += want != got
        if want != got:
            print(f"{name}: expected {str(want)[:300]}, got {str(got)[:300]}")
    print(f"{passed} passed, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
