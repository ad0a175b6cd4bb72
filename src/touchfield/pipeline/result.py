"""The result of a job, as commands print it and programs read it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Result:
    """Figures of a job by stable keys, and notes for people."""

    shown: Mapping[str, Any]
    notes: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return dict(self.shown)
