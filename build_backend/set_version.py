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

PLACES = {
    "src/touchfield/_version.py": (r'^__version__ = "(.+)"$', '__version__ = "{version}"'),
    "CITATION.cff": (r"^version: (.+)$", "version: {version}"),
    "docs/stability.md": (r"^touchfield is at version (\S+)\.(?= )", "touchfield is at version {version}."),
    "CHANGELOG.md": (r"^## Unreleased$", "## {version} - {date}"),
}
"""Of each file, a pattern of the line that states the version, and the new line."""


def edited(root: Path, version: str, date: str) -> dict[Path, str]:
    """Return the new texts of the files below `root`; write nothing.

    Raises `ValueError` if a file has another number of such lines than one, or `version` is not newer.
    """
    texts = {}
    for name, (pattern, line) in PLACES.items():
        text = (root / name).read_text(encoding="utf-8")
        found = list(re.finditer(pattern, text, re.MULTILINE))
        if len(found) != 1:
            raise ValueError(f"{name}: found {len(found)} lines that match {pattern}; expected one")
        if name.endswith("_version.py") and Version(found[0][1]) >= _parsed(version):
            raise ValueError(f"{name}: found version {found[0][1]}; expected one before {version}")
        new = line.format(version=version, date=date)
        texts[root / name] = text[: found[0].start()] + new + text[found[0].end() :]
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
        main(sys.argv[1])
    except ValueError as error:
        sys.exit(str(error))
