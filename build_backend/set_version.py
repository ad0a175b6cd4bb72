"""States a new version where the repository states it: python build_backend/set_version.py X.Y.Z

The section Unreleased of the changelog becomes that of the version, with today's date.
"""

from __future__ import annotations

import re
import sys
from datetime import UTC, datetime
from pathlib import Path

from compiler import ROOT
from packaging.version import InvalidVersion, Version

PLACES = (
    ("src/touchfield/_version.py", r'^__version__ = "(.+)"$', '__version__ = "{version}"'),
    ("CITATION.cff", r"^version: (.+)$", "version: {version}"),
    ("CITATION.cff", r"^date-released: (.+)$", "date-released: {date}"),
    ("docs/stability.md", r"^touchfield is at version (\S+)\.(?= )", "touchfield is at version {version}."),
    ("CHANGELOG.md", r"^## Unreleased$", "## {version} - {date}"),
)
"""Files, the pattern of a line that states the version or its date, and the new line."""


def edited(root: Path, version: str, date: str) -> dict[Path, str]:
    """Return the new texts of the files below `root`; write nothing.

    Raises `ValueError` if a file has another number of such lines than one, or `version` is not newer.
    """
    texts: dict[Path, str] = {}
    for name, pattern, line in PLACES:
        path = root / name
        text = texts.get(path) or path.read_text(encoding="utf-8")
        found = list(re.finditer(pattern, text, re.MULTILINE))
        if len(found) != 1:
            old = line.format(version="X.Y.Z", date="YYYY-MM-DD") if "(" in pattern else "## Unreleased"
            raise ValueError(f'{name}: found {len(found)} lines such as "{old}"; expected one, to edit it')
        if name.endswith("_version.py") and Version(found[0][1]) >= _parsed(version):
            raise ValueError(f"{name}: found version {found[0][1]}; expected one before {version}")
        new = line.format(version=version, date=date)
        texts[path] = text[: found[0].start()] + new + text[found[0].end() :]
    return texts


def _parsed(version: str) -> Version:
    try:
        parsed = Version(version)
    except InvalidVersion:
        raise ValueError(f"VERSION: found {version!r}; expected three numbers, such as 0.2.0") from None
    if str(parsed) != version or len(parsed.release) != 3:
        raise ValueError(f"VERSION: found {version!r}; expected three numbers, such as 0.2.0")
    return parsed


def main(version: str) -> None:
    """Edit the files of the repository."""
    for path, text in edited(ROOT, version, f"{datetime.now(UTC):%Y-%m-%d}").items():
        path.write_text(text, encoding="utf-8")
        print(f"{path.relative_to(ROOT)}: {version}")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2] or [""])
    except ValueError as error:
        sys.exit(str(error))
