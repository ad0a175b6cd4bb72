"""Identifies what a page was made from: hashes of the code and of every input, and the seeds.

Two runs with the same origin on one machine give the same digits. The code is that of this package and of
touchfield as a whole, without its native module, whose binary differs between compilers.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import touchfield
from reproduction.experiment import SEEDS
from touchfield.errors import SourceError

__all__ = ["code_hash", "input_hash", "origin"]

_DIGITS: Final = 16
_CODE: Final = frozenset((".py", ".toml"))
_PART: Final = 1 << 20


def origin(depth: Sequence[Path]) -> dict[str, Any]:
    """Return the hash of the code, those of the user's depth sequences by name, and the seeds."""
    inputs = {Path(folder).resolve().name: input_hash(folder) for folder in depth}
    return {"code": code_hash(), "inputs": inputs, "seeds": dict(SEEDS)}


def code_hash() -> str:
    """Return a hash of all Python and TOML files of this package and of touchfield.

    Ends of lines do not count.
    """
    packages = (Path(__file__).parent, Path(touchfield.__file__).parent)
    found = hashlib.sha256()
    for package in packages:
        for path in sorted(p for p in package.rglob("*") if p.suffix in _CODE):
            name = f"{package.name}/{path.relative_to(package).as_posix()}"
            _add(found, name, [path.read_bytes().replace(b"\r\n", b"\n")])
    return found.hexdigest()[:_DIGITS]


def input_hash(source: Path) -> str:
    """Return a hash of a file, or of the names and contents of all files of a folder.

    Raises
    ------
    SourceError
        If a file cannot be read.
    """
    paths = [source] if source.is_file() else sorted(p for p in source.rglob("*") if p.is_file())
    found = hashlib.sha256()
    for path in paths:
        name = path.name if path == source else path.relative_to(source).as_posix()
        try:
            with path.open("rb") as file:
                _add(found, name, iter(lambda: file.read(_PART), b""))
        except OSError as error:
            raise SourceError(str(path), error.strerror or str(error), "a file that can be read") from None
    return found.hexdigest()[:_DIGITS]


def _add(found: Any, name: str, parts: Iterable[bytes]) -> None:
    """Add a name and the hash of a content, so that no content can pass for a name."""
    content = hashlib.sha256()
    for part in parts:
        content.update(part)
    found.update(hashlib.sha256(name.encode("utf-8", "surrogateescape")).digest() + content.digest())
