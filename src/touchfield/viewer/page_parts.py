"""Fills the elements of a built page with data. Nothing in them can close its element."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping
from functools import cache
from importlib import resources
from typing import Any


@cache
def built_page(name: str) -> str:
    """Return a page of ``viewer/web`` as it was built, by the name of its file."""
    return resources.files("touchfield.viewer").joinpath(f"web/{name}").read_text(encoding="utf-8")


def json_text(values: Mapping[str, Any] | None, other_values: Callable[[Any], object] | None = None) -> str:
    """Return JSON for a script element; `other_values` converts what JSON cannot contain."""
    return json.dumps(values, default=other_values).replace("<", "\\u003c")


def base64_text(data: bytes) -> str:
    """Return bytes as Base64."""
    return base64.b64encode(data).decode("ascii")


def filled(element: str, data: bytes) -> str:
    """Return an empty element, such as ``<script></script>``, with bytes as Base64."""
    return element.replace("><", f">{base64_text(data)}<")
