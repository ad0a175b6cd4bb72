"""Build backend (PEP 517) of the package: calls hatchling, and asks for a C compiler from PyPI on machines
that have none.

Only the requirements are ours. Compiling is the build hook's part (``hook.py``).
"""

from __future__ import annotations

from typing import Any

from compiler import requirements
from hatchling import build as hatchling
from hatchling.build import build_editable, build_sdist, build_wheel, get_requires_for_build_sdist

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
]


def get_requires_for_build_wheel(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Packages that building a wheel needs."""
    return [*hatchling.get_requires_for_build_wheel(config_settings), *requirements()]


def get_requires_for_build_editable(config_settings: dict[str, Any] | None = None) -> list[str]:
    """Packages that an editable install needs."""
    return [*hatchling.get_requires_for_build_editable(config_settings), *requirements()]
