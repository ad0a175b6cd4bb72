"""Figures that a run of `rate.py` keeps in a folder, so that one that was interrupted goes on.

A figure's name holds what it depends on: the frames themselves, what was asked, and the source of what made it. So a
changed coder is measured again, and the peers are not.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import touchfield

BENCH = Path(__file__).parent
PACKAGE = Path(touchfield.__file__).parent
PEERS = ("rate_peers.py", "rate_symbols.py", "rate_contest.py", "rate_fields.py", "rate_parts.py", "rate_search.py")
OURS = ("rate_ours.py", "rate_parts.py", "rate_search.py")


def _sources(what: str) -> Iterator[Path]:
    if what == "fields":  # whatever may change the field, and no coder
        yield from (p for p in sorted(PACKAGE.rglob("*.py")) if PACKAGE / "codec" not in p.parents)
        yield BENCH / "rate_fields.py"
    elif what == "peers":  # and the coder whose error they are measured at
        yield from sorted((PACKAGE / "codec").glob("paper*.py"))
        yield from (BENCH / name for name in PEERS)
    else:
        yield from sorted((PACKAGE / "codec").rglob("*.py"))
        yield from (BENCH / name for name in OURS)


@cache
def fingerprint(what: str) -> str:
    """Of the source of "fields", "peers" or "ours"."""
    told = hashlib.sha256()
    for path in _sources(what):
        told.update(path.name.encode() + path.read_bytes())
    return told.hexdigest()[:12]


class Keep:
    """The folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.fields.mkdir(parents=True, exist_ok=True)

    @property
    def fields(self) -> Path:
        """Where the frames are, of this state of the source."""
        return self.folder / f"fields-{fingerprint('fields')}"

    def _path(self, name: str, key: Any) -> Path:
        told = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:16]
        return self.folder / f"{name.replace(' ', '-').replace(',', '')}-{told}.json"

    def get(self, name: str, key: Any) -> dict[str, Any] | None:
        """What an earlier run found."""
        path = self._path(name, key)
        return json.loads(path.read_text()) if path.exists() else None

    def put(self, name: str, key: Any, figures: dict[str, Any]) -> None:
        """Keep it; whole or not at all."""
        path = self._path(name, key)
        new = path.with_suffix(".new")
        new.write_text(json.dumps(figures, default=float))
        new.replace(path)
