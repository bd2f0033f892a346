"""Breaks the reference subscriber rule by rule; the golden vectors must notice each broken rule.

Usage: python3 check_mutants.py [-v]. Prints the mutants that survive; the exit code is 1 if there is one, or if a
mutant's source text is not there exactly once. `-v` prints what catches each mutant. Mutants are made in memory.
"""

import importlib.util
import json
import multiprocessing
import re
import signal
import sys
import time
from pathlib import Path

from mutants import FORMULAS, MESSAGES, MUTANTS, UNBROKEN

HERE = Path(__file__).resolve().parent
VECTORS = HERE.parent / "vectors"
# In the order of import; a mutant of one is seen by all after it.
SECONDS, MORE_SECONDS = 2, 40
MODULES = ("reckoning", "packets", "messages", "fec_decoder", "subscriber", "upstream", "check_streams", "check_messages", "check_reckoning")


class Endless(BaseException):
    """A mutant runs for too long."""


ORIGINALS = {}


def load(mutant=None):
    """Executes the modules anew, one of them changed, from that one on; those before it are the original ones."""
    first = MODULES.index(mutant.file) if mutant else 0
    for name in MODULES:
        sys.modules.pop(name, None)
    for place, name in enumerate(MODULES):
        if place < first:
            sys.modules[name] = ORIGINALS[name]
            continue
        path = HERE / f"{name}.py"
        source = path.read_text(encoding="utf-8")
        if mutant and name == mutant.file:
            source = source.replace(mutant.source, mutant.replacement)
        module = importlib.util.module_from_spec(importlib.util.spec_from_file_location(name, path))
        sys.modules[name] = module
        exec(compile(source, str(path), "exec"), module.__dict__)
    if mutant is None:
        ORIGINALS.update({name: sys.modules[name] for name in MODULES})


def vectors():
    """The streams, datagrams to refuse, and datagrams to accept."""
    scripted = json.loads((VECTORS / "scripted.json").read_text(encoding="utf-8"))
    packets = json.loads((VECTORS / "packets.json").read_text(encoding="utf-8"))
    return scripted["upstreams"] + scripted["streams"], scripted["refused"] + packets["refused"], packets["accepted"]


def caught(streams, refused, accepted, by_datagrams=True):
    """The first vector with another result than the stated one; None if there is none."""
    check_streams = sys.modules["check_streams"]
    for case in refused if by_datagrams else ():
        # A refusal for another reason is not normative.
        if decoded(case["bytes"]) is not None:
            return case["name"]
    for stream in streams:
        results = check_streams.upstream_results if stream["events"][0][0] == "grant" else check_streams.results
        try:
            if any(want != got for _, want, got in results(stream)):
                return stream["name"]
        except Exception as error:
            return f"{stream['name']}: {type(error).__name__}"
    for case in accepted if by_datagrams else ():
        if decoded(case["bytes"]) != case["means"]:
            return case["name"]
    return None


def caught_formula():
    """The first section of reckoning.json with another result than the stated one."""
    check_reckoning = sys.modules["check_reckoning"]
    vectors = json.loads((VECTORS / "reckoning.json").read_text(encoding="utf-8"))
    checks = check_reckoning.Checks(vectors)
    for section, cases in vectors.items():
        for case in cases if hasattr(checks, section) else ():
            try:
                if any(want != got for want, got in getattr(checks, section)(case)):
                    return section
            except Exception as error:
                return f"{section}: {type(error).__name__}"
    return None


def caught_message(rule):
    """The first message of control.json about a rule with another result than the stated one."""
    check_messages = sys.modules["check_messages"]
    for section, cases in json.loads((VECTORS / "control.json").read_text(encoding="utf-8")).items():
        side, *_ = [side for side in ("client", "server") if side in section] or [None]
        for case in cases if side else ():
            if case.get("rule") != rule:
                continue
            try:
                name, want, got = message_result(check_messages, section, side, case)
            except Exception as error:
                return f"{case['name']}: {type(error).__name__}"
            if want != got:
                return name
    return None


def message_result(check_messages, section, side, case):
    if section.startswith("long"):
        return check_messages.long(side, case)
    if section.startswith("refused"):
        return check_messages.refused(side, case)
    return check_messages.meaning(side, case)


def decoded(digits):
    packets = sys.modules["packets"]
    try:
        return packets.decoded(bytes.fromhex(digits))
    except packets.Malformed:
        return None
    except Exception as error:
        return type(error).__name__


def stop(*_):
    raise Endless


def tried(mutant):
    """The check that catches a mutant, and the processor time of that. A mutant that does not come to an end is caught."""
    load(mutant)
    start = time.process_time()
    signal.signal(signal.SIGPROF, stop)
    seconds = SECONDS if mutant not in FORMULAS + MESSAGES else MORE_SECONDS
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        if mutant in MESSAGES:
            by = caught_message(mutant.requirement)
        elif mutant in FORMULAS:
            by = caught_formula()
        else:
            by = caught(*GIVEN, mutant.file == "packets")
    except Endless:
        by = f"the limit of {seconds} s"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return mutant, by, time.process_time() - start


def faults():
    """Mutants that are not one change of one place."""
    for mutant in MUTANTS:
        count = (HERE / f"{mutant.file}.py").read_text(encoding="utf-8").count(mutant.source)
        if count != 1 or mutant.source == mutant.replacement:
            yield f"{mutant.requirement} {mutant.broken}: its source text is {count} times in {mutant.file}.py"


def unexplained():
    """Requirements of PROTOCOL 6 with neither a mutant nor a reason for having none, or with both."""
    stated = set(re.findall(r"\[(6\.\d+-\d+)\]", (HERE.parent / "PROTOCOL.md").read_text(encoding="utf-8")))
    broken = {mutant.requirement for mutant in MUTANTS if mutant.requirement.startswith("6.")}
    for requirement in sorted(stated ^ (broken | UNBROKEN.keys())):
        yield f"{requirement} is not stated, or has neither a mutant nor a reason for having none"
    for requirement in sorted(broken & UNBROKEN.keys()):
        yield f"{requirement} has a mutant and a reason for having none"


GIVEN = vectors()


def unbroken():
    """The vectors that fail without a mutant. The streams are in the order of their processor time after that."""
    streams, refused, accepted = GIVEN
    yield caught([], refused, accepted)
    yield caught_formula()
    for rule in sorted({mutant.requirement for mutant in MESSAGES}):
        yield caught_message(rule)
    seconds = {}
    for stream in streams:
        start = time.process_time()
        yield caught([stream], [], [])
        seconds[stream["name"]] = time.process_time() - start
    streams.sort(key=lambda stream: seconds[stream["name"]])


def main():
    wrong = [*faults(), *unexplained()]
    load()
    wrong += [f"without a mutant, this vector fails: {name}" for name in unbroken() if name]
    survivors, spent = 0, time.process_time()
    if not wrong:
        with multiprocessing.get_context("fork").Pool() as pool:
            for mutant, by, seconds in pool.imap_unordered(tried, MUTANTS, 4):
                spent += seconds
                survivors += by is None
                if by is None or "-v" in sys.argv:
                    print(f"{mutant.requirement} {mutant.broken}: {f'caught by {by}' if by else 'SURVIVES'}")
    for line in wrong:
        print(line)
    print(f"{len(MUTANTS)} mutants, {survivors} survive, {spent:.0f} s of processor time")
    return 1 if survivors or wrong else 0


if __name__ == "__main__":
    sys.exit(main())
