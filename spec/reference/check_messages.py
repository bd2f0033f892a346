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
        return ("error", None) if in_command else ("malformed", why.args[0])
    except messages.UnknownCommand:
        return "error", None
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
            what, _ = outcome(side, *one_frame(bytes.fromhex(case["bytes"])))
            yield case["name"], "malformed", what
    for rule in messages.TABLE["rules"]:
        # The type, and perhaps one of its codes.
        kind = next((kind for kind in messages.TYPES if f"{rule['of']} ".startswith(f"{kind} ")), None)
        yield f"the rule of {rule['of']}", True, kind is not None
    for case in vectors["frames"]:
        yield case["name"], (case["messages"], "refusal" in case), split(bytes.fromhex(case["bytes"]))


def accepted(side, case):
    data, name = bytes.fromhex(case["bytes"]), case["name"]
    kind, body = one_frame(data)
    what, means = outcome(side, kind, body)
    if "skipped" in case:
        yield name, "skipped", what
    elif "error" in case:
        yield name, "error", what
        # The table decodes messages that 2.6-29 and 3.5-5 refuse, and has no quantities.
        if means is not None:
            yield name, case["error"], means
    else:
        yield name, ("accepted", case["means"]), (what, means)
        yield name + ", written", data.hex(), messages.encoded(side, means).hex()
    longer = body + b"\0"
    accepted_lengths = [end for end in range(len(longer) + 1) if end != len(body) and outcome(side, kind, longer[:end])[0] != "malformed"]
    yield name + ", cut", case["cuts"], accepted_lengths


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
