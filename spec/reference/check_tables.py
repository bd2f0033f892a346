"""Checks what spec/tables says about the other files: digests, and which vectors and mutants try each requirement.

Usage: python3 check_tables.py [--write]. `digests.json` has the SHA-256 of each file of vectors and tables. In
`requirements.json` this script owns the columns `vectors`, `mutants` and `unobservable`; `cases` and `reason` are those
of the suite (`UPDATE_VECTORS=1 cargo test -p rhumb-conformance --lib coverage`). The words of PROTOCOL's reading path,
its listings of codes, and that no private value is assigned, are checked too. Where `spec/` is without the suite, that
one's mutants are left out: what the table says of them stays, and a line says so.
"""

import hashlib
import inspect
import json
import re
import sys
from pathlib import Path

import make_streams
import rule_streams
from mutants import MUTANTS, UNOBSERVABLE

SPEC = Path(__file__).resolve().parent.parent
DIGESTS, REQUIREMENTS = SPEC / "tables" / "digests.json", SPEC / "tables" / "requirements.json"
DOCUMENTS = ("PROTOCOL", "RECKONING")
SUITE = SPEC.parent / "tests" / "conformance" / "tests" / "suite"
# The clauses of PROTOCOL that list the codes of a type of protocol.json.
LISTED = {"4.2": "client message", "4.3": "server message", "4.4": "command", "4.6": "event", "4.15": "body event"}
FOUND = re.compile(r"\w+Mutant::\w+, which (L[\d.]+) finds")
NUMBER = re.compile(r"\[(\d+(?:\.\d+)*-\d+)\]")


def digest(data):
    return hashlib.sha256(data).hexdigest()


def digests():
    """The digests of all files, and the one over all vectors, as CONFORMANCE says."""
    vectors = sorted((SPEC / "vectors").glob("*.json"))
    tables = [SPEC / "tables" / name for name in ("packets.json", "protocol.json")]
    files = {path.relative_to(SPEC).as_posix(): digest(path.read_bytes()) for path in vectors + tables}
    lines = "".join(f"{files[name]}  {name}\n" for name in sorted(files) if name.startswith("vectors/"))
    return json.dumps({"format": "rhumb digests 1", "vectors": digest(lines.encode()), "files": files}, indent=1) + "\n"


def text(name):
    return (SPEC / f"{name}.md").read_text(encoding="utf-8")


def stated():
    """The requirements of each document, in its order."""
    return {name: NUMBER.findall(text(name)) for name in DOCUMENTS}


def cited(words, numbers):
    """The requirements that a list of citations names: `6.5-2`, `6.6-2 to 6.6-5`, `5.17`, `RECKONING 3.8-4`, `3.2–3.6`."""
    document = "PROTOCOL"
    for one in re.split(r",\s*(?:and )?", words.strip().rstrip(".")):
        named = re.fullmatch(r"(PROTOCOL |RECKONING )?([\d.]+(?:-\d+)?)(?:(?: to |–)([\d.]+(?:-\d+)?))?", one)
        if not named:
            continue
        document = (named[1] or document).strip()
        last = named[3] or named[2]
        for number in numbers[document]:
            clause = number.split("-")[0]
            of = number if "-" in named[2] else clause
            if key(named[2]) <= key(of) <= key(last):
                yield document, number


def key(number):
    return [int(part) for part in re.split(r"[.-]", number)]


def scripted(numbers):
    """The requirements of each scripted stream, from its maker's description, and of each refused datagram."""
    for module in (make_streams, rule_streams):
        for maker in vars(module).values():
            if not inspect.isfunction(maker) or maker.__module__ != module.__name__ or inspect.signature(maker).parameters:
                continue
            requirements = list(cited(inspect.getdoc(maker) or "", numbers))
            made = maker() if requirements else []
            for stream in [made] if hasattr(made, "recorded") else made:
                for requirement in requirements:
                    yield requirement, f"scripted: {stream.name}"
    for line in json.loads((SPEC / "vectors" / "scripted.json").read_text(encoding="utf-8"))["refused"]:
        for requirement in cited(line["breaks"], numbers):
            yield requirement, f"scripted: {line['name']}"


def ruled(numbers):
    """The requirements that lines of control.json are about."""
    vectors = json.loads((SPEC / "vectors" / "control.json").read_text(encoding="utf-8"))
    rules = {line["rule"] for lines in vectors.values() if isinstance(lines, list) for line in lines if "rule" in line}
    for rule in sorted(rules, key=key):
        for requirement in cited(rule, numbers):
            yield requirement, f"control: lines of rule {rule}"


def argued(rows):
    """The files of vectors that the reason for having no case names."""
    for document, of in rows.items():
        for number, row in of.items():
            for name in set(re.findall(r"(\w+)\.json|(golden vectors)", row.get("reason", ""))):
                yield (document, number), name[0] or "control"


def suite_mutants(old):
    """The suite's own mutants, as a row of `mutants` names them, with the case that must fail."""
    if not SUITE.is_dir():
        named = {name for rows in old.values() for row in rows.values() for name in row.get("mutants", ())}
        yield from ((found[1], name) for name in named if (found := FOUND.fullmatch(name)))
        return
    for side in ("client", "server"):
        source = (SUITE / f"{side}.rs").read_text(encoding="utf-8")
        for name, case in re.findall(r'\(\s*(\w+Mutant::\w+),[^()]*?"(L[\d.]+)",?\s*\)', source):
            yield case, f"{name}, which {case} finds"


def requirements():
    """The table, with this script's columns made anew."""
    numbers, old = stated(), json.loads(REQUIREMENTS.read_text(encoding="utf-8"))
    kept = {name: {number: {k: v for k, v in old.get(name, {}).get(number, {}).items() if k in ("cases", "reason")} for number in numbers[name]} for name in DOCUMENTS}
    vectors = {}
    for requirement, vector in [*scripted(numbers), *ruled(numbers), *argued(kept)]:
        vectors.setdefault(requirement, set()).add(vector)
    for (document, number), of in vectors.items():
        kept[document][number]["vectors"] = sorted(of)
    for mutant in MUTANTS:
        for document, number in cited(mutant.requirement, numbers):
            kept[document][number].setdefault("mutants", []).append(mutant.broken)
    for words, why in UNOBSERVABLE.items():
        for document, number in cited(words, numbers):
            kept[document][number]["unobservable"] = why
    for case, name in sorted(suite_mutants(old)):
        for row in (row for rows in kept.values() for row in rows.values() if case in row.get("cases", "").split()):
            row.setdefault("mutants", []).append(name)
    return listed(kept)


def listed(rows):
    """One requirement a line, as the suite's test writes it."""

    def line(number, row):
        return f'"{number}": {json.dumps(row, ensure_ascii=False, sort_keys=True, separators=(",", ":"))}'

    documents = (f'"{name}": {{\n' + ",\n".join(line(*one) for one in rows[name].items()) + "\n}" for name in DOCUMENTS)
    return "{\n" + ",\n".join(documents) + "\n}\n"


def bare():
    """The requirements without a vector, a case, a mutant or a reason."""
    for document, rows in json.loads(requirements()).items():
        for number, row in rows.items():
            if not row:
                yield f"{document} {number} has neither a vector, a case, a mutant nor a reason"


def words_of(name, sections):
    """The words of sections of a document, `sections` as the reading path lists them."""
    total, counts, parts = 0, {}, re.split(r"^#+ ", text(name), flags=re.MULTILINE)
    for part in parts[1:]:
        number = part.split()[0]
        if re.fullmatch(r"[\d.]+", number):
            counts[number] = len(part.split()) + 1
    for one in sections.split(","):
        first, last = ([*one.split(" to "), one][:2] if " to " in one else (one, one))
        first, last = key(first.strip()), key(last.strip())
        total += sum(count for number, count in counts.items() if first <= key(number)[: len(first)] and key(number)[: len(last)] <= last)
    return total


def path():
    """The rows of the reading path whose words are more than 50 and a twentieth off."""
    for profile, words, sections in re.findall(r"^    ([a-z, ]+?) +([\d,]+) +(PROTOCOL .*)$", text("PROTOCOL"), re.MULTILINE):
        now = sum(words_of(*one.strip().split(" ", 1)) for one in sections.split(";"))
        if abs(now - int(words.replace(",", ""))) > 50 + now / 20:
            yield f"the reading path of *{profile}* has {now} words, not {words}"


def listings():
    """Codes and names that the listings of PROTOCOL and protocol.json do not share."""
    table = json.loads((SPEC / "tables" / "protocol.json").read_text(encoding="utf-8"))
    stated = {clause: table["types"][of]["codes"] for clause, of in LISTED.items()} | {"3.4": table["close codes"]}
    for clause, rows in stated.items():
        section = re.search(rf"^### {re.escape(clause)} .*?(?=^##)", text("PROTOCOL"), re.MULTILINE | re.DOTALL)[0]
        listed = {(int(code), name) for code, name in re.findall(r"^    (\d+) +(\w+)", section, re.MULTILINE)}
        for code, name in sorted(listed ^ {(row["code"], row["name"]) for row in rows}):
            yield f"PROTOCOL {clause} and protocol.json differ in {code} {name}"


def private():
    """Assigned values in the private ranges of PROTOCOL 12-2."""
    table = json.loads((SPEC / "tables" / "protocol.json").read_text(encoding="utf-8"))
    for name, of in table["types"].items():
        for row in of.get("codes", []):
            if row["code"] >= 0xF0:
                yield f"{name} {row['code']} is private"
    for row in table["close codes"]:
        if 4096 <= row["code"] < 8192:
            yield f"close code {row['code']} is private"


def main():
    wrong = [*path(), *listings(), *private()]
    for file, made in ((DIGESTS, digests), (REQUIREMENTS, requirements)):
        if "--write" in sys.argv:
            file.write_text(made(), encoding="utf-8")
        elif not file.exists() or file.read_text(encoding="utf-8") != made():
            wrong.append(f"{file.name} differs: python3 spec/reference/check_tables.py --write")
    for name, numbers in stated().items():
        wrong += [f"{name} {number} is stated twice" for number in sorted({one for one in numbers if numbers.count(one) > 1})]
    wrong += bare()
    for line in wrong:
        print(line)
    if not SUITE.is_dir():
        print("left out, as the suite (tests/conformance) is not beside spec/: which of its cases and mutants there are")
    print(f"{sum(map(len, stated().values()))} requirements, {len(wrong)} faults of the tables")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
