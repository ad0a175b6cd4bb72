"""`Result`: what a task returns to commands and programs, figures by name and notes for people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Result:
    """Figures by stable keys, and notes for people."""

    figures: Mapping[str, Any]
    notes: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return dict(self.figures)
