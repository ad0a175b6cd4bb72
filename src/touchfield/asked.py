"""Fields of a spec that the command line asks for, too, each with its words in the help: one list for both."""

from __future__ import annotations

from dataclasses import field
from typing import Any


def option(default: Any, words: str) -> Any:
    """A field of a frozen dataclass, ``--its-name`` on the command line, where `words` are its help."""
    return field(default=default, metadata={"help": words})
