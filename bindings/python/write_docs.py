"""Writes the documentation of the stubs into the native module.

    python3 bindings/python/write_docs.py

help() has it from there. The stubs are where it is edited; a test of the package compares the two.
"""

import ast
import pathlib
import re

HERE = pathlib.Path(__file__).parent


def documentation(stubs):
    """The sentences of each class and function: {(class or None, name or None): lines}."""
    found = {}
    for node in stubs.body:
        if isinstance(node, ast.FunctionDef):
            found[None, node.name] = ast.get_docstring(node)
        if not isinstance(node, ast.ClassDef):
            continue
        found[node.name, None] = ast.get_docstring(node)
        for member in node.body:
            if isinstance(member, ast.FunctionDef):
                found[node.name, member.name] = ast.get_docstring(member)
    return {key: text.splitlines() for key, text in found.items() if text}


def comments(lines, indent):
    return [f"{indent}/// {line}".rstrip() for line in lines]


def is_documentation(line):
    return line.lstrip().startswith("///")


def with_item(lines, at, text, indent, is_field):
    """The item whose name stands in line `at`, documented. It begins after the last blank line or brace."""
    begin = at
    while begin > 0 and lines[begin - 1].strip() and not re.match(r"impl .*\{$", lines[begin - 1]):
        if is_field and not is_documentation(lines[begin - 1]):
            break
        begin -= 1
    head = [line for line in lines[begin:at] if not is_documentation(line)]
    return lines[:begin] + comments(text, indent) + head + lines[at:]


def rewritten(source, known):
    """The source of a file with the documentation that is known of its classes and functions."""
    lines = source.splitlines()
    names = dict(re.findall(r'#\[pyclass\([^]]*name = "(\w+)"[^]]*\)\][^{]*?struct (\w+)', source))
    names = {struct: name for name, struct in names.items()}
    place, owner, is_field = 0, None, False
    while place < len(lines):
        line = lines[place]
        if block := re.match(r"impl (\w+) \{$", line):
            methods = place > 0 and lines[place - 1] == "#[pymethods]"
            # Methods of a class of another file.
            owner, is_field = names.get(block[1], block[1].removeprefix("Py")) if methods else None, False
        elif line == "}":
            owner, is_field = None, False
        key = indent = field = struct = None
        if struct := re.match(r"pub\(crate\) struct (\w+)", line):
            key, indent = (names.get(struct[1]), None), ""
        elif method := re.match(r"    (?:const )?fn (\w+)", line):
            given = re.search(r'name = "(\w+)"', lines[place - 1]) or re.search(r'name = "(\w+)"', lines[place - 2])
            key, indent = (owner, given[1] if given and owner else method[1]), "    "
        elif function := re.match(r"pub\(crate\) fn (\w+)", line):
            key, indent = (None, function[1]), ""
        elif is_field and (field := re.match(r"    (\w+):", line)):
            key, indent = (owner, field[1]), "    "
        text = known.get(key)
        if text and (key[0] or key[1]):
            before = len(lines)
            lines = with_item(lines, place, text, indent, bool(is_field and field))
            place += len(lines) - before
        if struct and "get_all" in "\n".join(lines[max(0, place - 3) : place]) and line.endswith("{"):
            owner, is_field = names.get(struct[1]), True
        place += 1
    return "\n".join(lines) + "\n"


def main():
    known = documentation(ast.parse((HERE / "python/rhumb/_native.pyi").read_text()))
    for path in sorted((HERE / "src").glob("*.rs")):
        source = path.read_text()
        if (written := rewritten(source, known)) != source:
            path.write_text(written)
            print(path.name)


if __name__ == "__main__":
    main()
