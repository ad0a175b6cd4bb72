"""Damages text formats by their structure: a value of a JSON or XML tree, or a word, line or column of text.
Also damages bytes and bits without a structure; `mutation_binary` has chunks, tables and archives.

A mutator takes the bytes of a valid file and a random generator, and returns other bytes. Where a format has
lengths and checks, they are made to hold in most cases, so that the damage reaches the code behind them.
"""

from __future__ import annotations

import json
import random
import re
import struct
from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import Any, Final
from xml.etree import ElementTree

Mutator = Callable[[bytes, random.Random], bytes]

ODD_NUMBERS: Final = (
    *("0", "-1", "1", "1e400", "-1e400", "1e308", "-1.7e308", "1e-320", "1e30", "0.5", "1" + "0" * 400),
    *("nan", "inf", "-inf", "NaN", "Infinity", "-0.0", "255", "65536", "2147483647", "2147483648"),
    *("4294967295", "4294967296", "9223372036854775807", "9223372036854775808", "-9223372036854775809"),
    *("1e9", "1e15", "0x10", "1_000", "1,5", "٣", "", "true", "null", '"text"'),
)
OUTSIDE: Final = "../outside/secret"
"""Path of the files that no reader may open, without the ending; `fuzz_parsers` lays them there."""
ODD_TEXTS: Final = (
    *("", " ", "\0", "a\0b", "x" * 5000, "../..", "/", "/etc/passwd", OUTSIDE, "C:\\x", "a/" * 40),
    *(
        "\x1b[2J",
        "\u202etxt.exe",
        "é\ud800",
        "%s%n",
        "{0}",
        "NaN",
        "file:///etc/passwd",
        "http://127.0.0.1:9/x",
    ),
    *("data:,", "data:;base64,!!!!", "..", ".", "~", "-", "1" * 5000),
)
ODD_INTEGERS: Final = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 1 << 24, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
WIDE_INTEGERS: Final = (*ODD_INTEGERS, 1 << 40, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)
ODD_DOUBLES: Final = (0.0, -1.0, 1e300, -1e308, 5e-324, float("nan"), float("inf"), -float("inf"), 1e18)


# -- bytes and bits ----------------------------------------------------------------------------------------


def raw(data: bytes, rng: random.Random) -> bytes:
    """Damage bytes anywhere, half of the time near the start."""
    out, at = bytearray(data), rng.randrange(len(data) or 1)
    if rng.random() < 0.5:
        at = min(at, rng.randrange(128))
    width = rng.choice((1, 2, 4, 8))
    match rng.randrange(8):
        case 0:
            for _ in range(rng.randint(1, 8)):
                flip(out, rng.randrange(8 * len(out) or 1))
        case 1:
            return data[:at]
        case 2:
            out[at : at + width] = integer(rng, width, rng.choice(("little", "big")))
        case 3:
            out[at : at + 8] = struct.pack(rng.choice("<>") + "d", rng.choice(ODD_DOUBLES))
        case 4:
            out[at : at + rng.randint(1, 40)] = rng.randbytes(rng.randint(0, 40))
        case 5:
            out[at:at] = data[at : at + rng.randint(1, 400)] * rng.choice((1, 2, 50))
        case 6:
            del out[at : at + rng.randint(1, 200)]
        case _:
            out[at : at + rng.randint(1, 60)] = bytes([rng.choice((0, 255))]) * rng.randint(1, 60)
    return bytes(out)


def flip(out: bytearray, bit: int) -> None:
    """Change one bit, if there is any byte."""
    if out:
        out[bit // 8] ^= 1 << bit % 8


def integer(rng: random.Random, width: int, order: Any) -> bytes:
    """Return an odd unsigned integer of `width` bytes."""
    return (rng.choice(WIDE_INTEGERS) & ((1 << 8 * width) - 1)).to_bytes(width, order)


def bit_fields(data: bytes, rng: random.Random) -> bytes:
    """Set fields of 1 to 32 bits, at any bit, as in a format without bytes (HMPG)."""
    bits, count = int.from_bytes(data, "big"), 8 * len(data)
    for _ in range(rng.randint(1, 3)):
        width = rng.choice((1, 2, 3, 4, 6, 8, 16, 17, 24, 32))
        at = rng.randrange(max(count - width, 1))
        mask = ((1 << width) - 1) << at
        bits = bits & ~mask | (rng.choice((0, 1, (1 << width) - 1, rng.getrandbits(width))) << at)
    return (bits & ((1 << count) - 1)).to_bytes(len(data), "big")


def one_of(*mutators: Mutator) -> Mutator:
    """Return a mutator that applies one of several, or now and then two."""

    def mutate(data: bytes, rng: random.Random) -> bytes:
        for _ in range(1 + (rng.random() < 0.25)):
            try:
                data = rng.choice(mutators)(data, rng)
            except (Malformed, RecursionError):
                data = raw(data, rng)
        return data

    return mutate


class Malformed(ValueError):
    """The bytes have not the structure that a mutator changes."""


# -- trees: JSON and XML -----------------------------------------------------------------------------------


def json_tree(data: bytes, rng: random.Random) -> bytes:
    """Change one to three values or keys of a JSON document."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        raise Malformed from None
    literals: dict[str, str] = {}
    for _ in range(rng.randint(1, 3)):
        document = _changed_tree(document, rng, literals)
    text = json.dumps(document)
    for mark, literal in literals.items():
        text = text.replace(f'"{mark}"', literal)
    return text.encode("utf-8", "surrogatepass")


def _changed_tree(document: Any, rng: random.Random, literals: dict[str, str]) -> Any:
    owners = list(_containers(document))
    if not owners or rng.random() < 0.01:
        return rng.choice(([], {}, 0, None, "text", [[]] * 1000))
    owner = rng.choice(owners)
    key = rng.choice(list(owner) if isinstance(owner, dict) else range(len(owner)))
    match rng.randrange(8):
        case 0:
            del owner[key]
        case 1 if isinstance(owner, dict):
            owner[rng.choice((*ODD_TEXTS, *owner))] = owner[key]
        case 1:
            owner[key:key] = [deepcopy(owner[key]) for _ in range(rng.choice((1, 3, 300)))]
        case 2:
            other = rng.choice(owners)
            owner[key] = deepcopy(rng.choice(list(other.values()) if isinstance(other, dict) else other))
        case 3:
            owner[key] = rng.choice((None, True, False, [], {}, [owner[key]], {"a": owner[key]}, [None] * 9))
        case 4:
            owner[key] = rng.choice(ODD_TEXTS)
        case 5 if rng.random() < 0.1:
            owner[key] = _literal("[" * 60_000 + "]" * 60_000, literals)
        case 5 if isinstance(owner[key], int | float):
            owner[key] = rng.choice((-1, 2, 1e3, 1e-3, 1e6)) * owner[key] + rng.choice((0, 1, -1, 0.5))
        case _:
            owner[key] = _literal(rng.choice(ODD_NUMBERS) or "null", literals)
    return document


def _containers(node: Any) -> Iterator[Any]:
    """Yield every object and array that is not empty."""
    if isinstance(node, dict | list) and node:
        yield node
        for child in list(node.values()) if isinstance(node, dict) else node:
            yield from _containers(child)


def _literal(text: str, literals: dict[str, str]) -> str:
    """Return a mark that is replaced by `text` once the document is written."""
    mark = f"@{len(literals)}@"
    literals[mark] = text
    return mark


_ENTITIES: Final = b'<!DOCTYPE a [<!ENTITY a "%s"><!ENTITY b SYSTEM "file:///etc/passwd">%s]>'
_LAUGHS: Final = b"".join(b'<!ENTITY l%d "%s">' % (i, b"&l%d;" % (i - 1) * 10) for i in range(1, 9))


def xml_tree(data: bytes, rng: random.Random) -> bytes:
    """Change one to three elements, attributes or texts of an XML document; sometimes declare entities."""
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, LookupError):  # LookupError: an encoding that was damaged before
        raise Malformed from None
    for _ in range(rng.randint(1, 3)):
        _change_element(rng.choice(list(root.iter())), root, rng)
    text = ElementTree.tostring(root).replace(b"@entity@", rng.choice((b"&a;", b"&b;", b"&l8;", b"&c;")))
    if b"&" in text or rng.random() < 0.02:
        text = _ENTITIES % (b"ha", b'<!ENTITY l0 "ha">' + _LAUGHS) + text
    if rng.random() < 0.01:
        text = b"<a>" * 50_000 + text + b"</a>" * 50_000
    return text


def _change_element(element: Any, root: Any, rng: random.Random) -> None:
    children = list(element)
    match rng.randrange(8):
        case 0 if children:
            element.remove(rng.choice(children))
        case 1 if children:
            element.extend(deepcopy(rng.choice(children)) for _ in range(rng.choice((1, 2, 200))))
        case 2:
            element.append(deepcopy(rng.choice(list(root.iter()))))
        case 3:
            element.tag = rng.choice(list(root.iter())).tag
        case 4 if element.text and element.text.strip():
            element.text = changed_tokens(element.text, rng)
        case _ if element.attrib:
            name = rng.choice(list(element.attrib))
            if rng.random() < 0.15:
                del element.attrib[name]
            else:
                element.attrib[name] = _xml_value(element.attrib[name], rng)
        case _:
            element.text = _xml_value(element.text or "", rng)


def _xml_value(text: str, rng: random.Random) -> str:
    changed = rng.choice(
        (changed_tokens(text, rng), rng.choice(ODD_TEXTS), rng.choice(ODD_NUMBERS), "@entity@")
    )
    return re.sub("[\0-\x08\x0b-\x1f\ud800]", "?", changed)  # these would make it no XML


# -- text --------------------------------------------------------------------------------------------------

_TOKEN: Final = re.compile(r"[^\s,;=:\[\]{}()\"']+")
_NUMBER: Final = re.compile(r"[-+]?\.?\d[\d.eE+-]*")


def changed_tokens(text: str, rng: random.Random) -> str:
    """Replace one to three words of a text, numbers three times of four."""
    for _ in range(rng.randint(1, 3)):
        found = list((_NUMBER if rng.random() < 0.75 else _TOKEN).finditer(text))
        if found:
            word = rng.choice(found if rng.random() < 0.5 else found[:40])
            new = rng.choice((*ODD_NUMBERS, rng.choice(ODD_TEXTS), f"{word[0]} {word[0]}"))
            text = text[: word.start()] + new + text[word.end() :]
    return text


def columns(data: bytes, rng: random.Random) -> bytes:
    """Change words, lines or columns of a text."""
    text = data.decode("latin-1")
    lines = text.split("\n")
    at = rng.randrange(len(lines)) if rng.random() < 0.5 else min(rng.randrange(20), len(lines) - 1)
    match rng.randrange(9):
        case 0:
            del lines[at]
        case 1:
            lines[at:at] = [rng.choice(lines)] * rng.choice((1, 2, 2000))
        case 2:
            lines[at] = lines[at].rpartition(rng.choice(" ,;\t"))[0]
        case 3:
            lines[at] += rng.choice((" 1", ",1", " x", "\r", "\\", "#", " " * 9000, ",".join("1" * 3000)))
        case 4:
            lines = [rng.choice((",", " ", ";", "\t")).join(line.split()) for line in lines]
        case 5:
            lines[at] = rng.choice(ODD_TEXTS)
        case _:
            return changed_tokens(text, rng).encode("utf-8", "surrogatepass")
    return "\n".join(lines).encode("utf-8", "surrogatepass")


def header_only(data: bytes, rng: random.Random, end: bytes) -> bytes:
    """Change words of the text before `end`, and keep what follows."""
    at = data.find(end)
    if at < 0:
        raise Malformed
    return columns(data[:at], rng) + data[at:]


def header_until(end: bytes) -> Mutator:
    """Return the mutator of a text header before binary data."""
    return lambda data, rng: header_only(data, rng, end)
