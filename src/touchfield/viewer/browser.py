"""The page in the browser: a file, a decoder of it and all that shows it in one HTML file that asks no
network.

The page itself, `web/page.html`, is made from the sources in the folder `web` of the repository (``make
web``).
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from importlib import resources
from typing import Any, Final

_FIGURES: Final = '<script type="application/json" id="given-figures">null</script>'
_MOVIE: Final = '<script type="text/plain" id="given-movie" data-type="" data-at="0"></script>'
_SOURCE: Final = '<script type="text/plain" id="given-source"></script>'
_MEDIUM: Final = '<script type="text/plain" id="given-medium" data-name=""></script>'


@cache
def empty_page() -> str:
    """The page without a file: one is dropped on it, or opened."""
    return resources.files("touchfield.viewer").joinpath("web/page.html").read_text(encoding="utf-8")


@cache
def served_page() -> str:
    """The page around `empty_page` that fetches from its own server: a file by its name, or what is live
    there.
    """
    page = resources.files("touchfield.viewer").joinpath("web/from-server.html").read_text(encoding="utf-8")
    for mark, element in (("@SCRIPT@", "script"), ("@STYLE@", "style")):
        text = page.partition(f"<{element}>")[2].partition(f"</{element}>")[0]
        page = page.replace(mark, f"'sha256-{base64.b64encode(sha256(text.encode()).digest()).decode()}'")
    return page


def page_of(
    data: bytes,
    name: str,
    figures: Mapping[str, Any] | None = None,
    movie: tuple[bytes, str, float] | None = None,
    source: bytes = b"",
) -> str:
    """The page with a ``.touch`` file within, and perhaps a movie beside it, on one clock.

    `figures` is what is known beyond the file, by the keys of ``touchfield info --json`` and ``compare
    --json``; `movie` a file that browsers play, its media type, and its second at which the touch begins;
    `source` what was encoded, as a file on the same lattice: the page shows it, and the difference, too.
    """
    known = json.dumps(figures, default=str).replace(
        "<", "\\u003c"
    )  # no word of a stranger's ends the element
    medium = base64.b64encode(data).decode("ascii")
    named = _MEDIUM.replace('data-name=""', f'data-name="{html.escape(name)}"')
    shown = _MOVIE
    if movie is not None:
        film, kind, at_s = movie
        shown = _MOVIE.replace(
            'data-type="" data-at="0"', f'data-type="{html.escape(kind)}" data-at="{at_s:.6f}"'
        )
        shown = shown.replace("><", f">{base64.b64encode(film).decode('ascii')}<")
    beside = _SOURCE.replace("><", f">{base64.b64encode(source).decode('ascii')}<")
    page = empty_page().replace(_MOVIE, shown).replace(_FIGURES, _FIGURES.replace("null", known))
    page = page.replace(_SOURCE, beside)
    return page.replace(_MEDIUM, named.replace("><", f">{medium}<"))
