"""The words of an error about a folder that is not what it should be: what lies in it."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from pathlib import Path
from typing import Final

from touchfield.errors import SourceError
from touchfield.sources.pictures import PICTURE_SUFFIXES, picture_header

__all__ = ["contents"]

_MOST_SEEN: Final = 10_000
_MOST_KINDS: Final = 5


def contents(folder: Path) -> str:
    """A folder in words: "24 .png (8-bit RGB), 1 .txt, folders colour/ and poses/"; bounded, and never an error."""
    try:
        entries = sorted(islice((p for p in folder.iterdir() if not p.name.startswith(".")), _MOST_SEEN))
    except OSError as error:
        return error.strerror or str(error)
    files = [p for p in entries if p.is_file()]
    kinds = Counter(p.suffix.lower() or "without an ending" for p in files).most_common(_MOST_KINDS)
    told = [f"{count} {kind}{_kind_of(files, kind)}" for kind, count in kinds]
    inner = [f"{p.name}/" for p in entries if p.is_dir()]
    if inner:
        told.append("the folders " + " ".join(inner[:_MOST_KINDS]) + " ..." * (len(inner) > _MOST_KINDS))
    return ", ".join(told) or "nothing"


def _kind_of(files: list[Path], suffix: str) -> str:
    """The samples of the first picture of a kind, in brackets; nothing for other files."""
    if suffix not in PICTURE_SUFFIXES:
        return ""
    try:
        return f" ({picture_header(next(p for p in files if p.suffix.lower() == suffix)).wording})"
    except SourceError:
        return ""
