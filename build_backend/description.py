"""Hook that hatchling calls for the metadata: the README as a package index shows it.

An index has neither the files nor the pictures of the repository, so relative links would lead nowhere.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_PICTURE = re.compile(r"^!\[[^\]]*\]\((?!https?://)[^)]*\)\n\n(\*[^*]+\*\n\n)?", re.MULTILINE)
"""A picture of the repository, and its caption in italics."""

_LINK = re.compile(r"\[([^\]]+)\]\((?!https?://)[^)]+\)")


def description(readme: str) -> str:
    """Return a README without its relative pictures, and with the texts of its relative links."""
    return _LINK.sub(r"\1", _PICTURE.sub("", readme))


class Description(MetadataHookInterface):
    """States the field `readme` of the metadata."""

    def update(self, metadata: dict[str, Any]) -> None:
        readme = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {"content-type": "text/markdown", "text": description(readme)}
