"""Finds the declarations of C that a function needs: functions, types, constants and macros, in all headers.

A change of the struct of a servo is then none of a coder, though both stand in one compiled module. Names are
followed as they are written: a declaration needs every declaration whose name it contains. That may be more
than a compiler needs, and is never less.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

STRINGS: Final = r"\"(?:\\.|[^\"\\])*\"|'(?:\\.|[^'\\])*'|`(?:\\.|[^`\\])*`"
_COMMENTS: Final = re.compile(rf"{STRINGS}|//[^\n]*|/\*.*?\*/", re.DOTALL)
_PIECES: Final = re.compile(
    rf"{STRINGS}|(?m:^[ \t]*#(?:[^\n\\]|\\.|\\\n)*)|[{{}}();]|[^{{}}();\"'`#]+|.", re.DOTALL
)
_WORDS: Final = re.compile(rf"{STRINGS}|([A-Za-z_]\w*)")
_DEFINE: Final = re.compile(r"#\s*define\s+(\w+)")
_CONDITION: Final = re.compile(r"#\s*(ifndef|ifdef|if|elif|else|endif)\b")
_CPLUSPLUS: Final = re.compile(r"extern\s*\"C\"\s*$")
_CALLED: Final = re.compile(r"(\w+)\s*\)?\s*\(")
_VALUES: Final = re.compile(r"(\w+)\s*(?:\[[^\]]*\]\s*)*=\s*\{")
"""A constant with a list of values."""
_TYPES: Final = frozenset(("char", "double", "float", "int", "int64_t", "long", "size_t", "uint64_t", "void"))
_ATTRIBUTES: Final = frozenset(("__attribute__", "__declspec"))


@dataclass(frozen=True)
class Declaration:
    """What stands by itself in a file of C, with white space collapsed.

    The text begins with the conditions of the preprocessor that it depends on.
    """

    names: frozenset[str]
    text: str


def without_comments(text: str) -> str:
    """Return C with a space for each comment."""
    return _COMMENTS.sub(lambda found: found[0] if found[0][0] in "\"'`" else " ", text)


def declarations(text: str) -> Iterator[Declaration]:
    """Yield the declarations of a file, without its includes."""
    conditions: list[str] = []
    written, depth = "", 0
    for piece in _PIECES.findall(without_comments(text)):
        if piece.lstrip().startswith("#") and not written.strip():
            yield from _of_directive(piece, conditions)
            continue
        written += piece
        if piece in "{(":
            depth += 1
        elif piece in "})":
            depth -= 1
        if depth == 1 and _CPLUSPLUS.search(written[:-1]):
            written, depth = "", 0  # its closing brace stands under the same condition, and is dropped below
        elif (depth == 0 and (piece == ";" or (piece == "}" and _is_function(written)))) or depth < 0:
            if depth == 0:
                yield _declaration(written, conditions)
            written, depth = "", 0


def _of_directive(line: str, conditions: list[str]) -> Iterator[Declaration]:
    """Yield the macro that a line defines, or follow it into or out of a condition."""
    line = " ".join(line.replace("\\\n", " ").split())
    found = _DEFINE.match(line)
    if found and found[1] != _guard(conditions):
        yield Declaration(frozenset((found[1],)), _under(conditions, line))
    elif found := _CONDITION.match(line):
        if found[1] == "endif":
            conditions.pop()
        elif found[1] in ("else", "elif"):
            conditions[-1] += f" {line}"
        else:
            conditions.append(line)


def _guard(conditions: Sequence[str]) -> str:
    """Return the macro by which a header is read once; empty if there is none."""
    found = re.match(r"#ifndef (\w+_H)$", conditions[0]) if conditions else None
    return found[1] if found else ""


def _under(conditions: Sequence[str], text: str) -> str:
    """Return a text behind its conditions, without that of the whole header."""
    return " ".join([*conditions[bool(_guard(conditions)) :], text])


def _is_function(text: str) -> bool:
    """Return whether a text that ends with a brace is a function with its body."""
    return text.split("{", 1)[0].rstrip().endswith(")")


def _declaration(text: str, conditions: Sequence[str]) -> Declaration:
    return Declaration(frozenset(_defined(text)), _under(conditions, " ".join(text.split())))


def _defined(text: str) -> Iterator[str]:
    """Yield the names that a declaration defines; not those of fields, arguments and variables within."""
    head, brace, body = text.partition("{")
    is_block = brace and not _is_function(text)
    if is_block and (values := _VALUES.search(text)):
        yield values[1]
    elif is_block:
        inside, _, behind = body.rpartition("}")
        if "enum" in words(head):
            yield from re.findall(r"(\w+)\s*(?:=[^,]*)?(?:,|$)", inside)
        yield from re.findall(r"\b(?:struct|enum|union)\s+(\w+)", head)
        yield from re.findall(r"\w+", behind)
    elif "(" in head:
        yield from (name for name in _CALLED.findall(head) if name not in _TYPES | _ATTRIBUTES)
    else:
        yield from re.findall(r"(\w+)\s*(?:\[[^\]]*\]\s*)*(?:=[^,]*)?[,;]", head)


def words(text: str) -> set[str]:
    """Return the identifiers in a text of C."""
    return {found for found in _WORDS.findall(text) if found}


def by_name(texts: Iterable[str]) -> dict[str, list[Declaration]]:
    """Return the declarations of the files with these texts, by each name that they define."""
    found: dict[str, list[Declaration]] = {}
    for text in texts:
        for declaration in declarations(text):
            for name in declaration.names:
                found.setdefault(name, []).append(declaration)
    return found


def needed(known: Mapping[str, list[Declaration]], roots: Iterable[str]) -> list[Declaration]:
    """Return the declarations that the names `roots` need, sorted by their texts."""
    found, waiting = set[Declaration](), [name for name in roots if name in known]
    seen = set(waiting)
    while waiting:
        for declaration in known[waiting.pop()]:
            found.add(declaration)
            more = (words(declaration.text) & known.keys()) - seen
            seen |= more
            waiting += more
    return sorted(found, key=lambda declaration: declaration.text)
