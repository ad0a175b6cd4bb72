"""Makes the HTML page that plays a ``.touch`` file in a browser, and the page of a tactile map. The file and
its decoder are within the page.

They need no network access. The pages themselves, `web/page.html` and `web/map.html`, are built from the
folder `web` of the repository (``make web``).
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
    """Return the page without a file; the user drops or opens one."""
    return resources.files("touchfield.viewer").joinpath("web/page.html").read_text(encoding="utf-8")


@cache
def empty_map_page() -> str:
    """Return the page of maps without a file; the user drops or opens one."""
    return resources.files("touchfield.viewer").joinpath("web/map.html").read_text(encoding="utf-8")


@cache
def served_page() -> str:
    """Return the page that loads a file by name, or the live stream, from its own server."""
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
    """Return the page with a ``.touch`` file, and optionally a movie on the same clock.

    `figures` has additional figures by the keys of ``touchfield info --json`` and ``compare --json``. `movie`
    is a file that browsers play, its media type, and its second at which the touch starts. `source` is the
    source as a ``.touch`` file on the same lattice; the page also shows it and the difference.
    """
    figures_json = json.dumps(figures, default=str).replace(
        "<", "\\u003c"
    )  # untrusted text cannot close the element
    movie_element = _MOVIE
    if movie is not None:
        film, kind, at_s = movie
        movie_element = _MOVIE.replace(
            'data-type="" data-at="0"', f'data-type="{html.escape(kind)}" data-at="{at_s:.6f}"'
        )
        movie_element = movie_element.replace("><", f">{base64.b64encode(film).decode('ascii')}<")
    source_element = _SOURCE.replace("><", f">{base64.b64encode(source).decode('ascii')}<")
    page = (
        empty_page().replace(_MOVIE, movie_element).replace(_FIGURES, _FIGURES.replace("null", figures_json))
    )
    page = page.replace(_SOURCE, source_element)
    return _with_medium(page, data, name)


def map_page_of(data: bytes, name: str) -> str:
    """Return the page of maps with a ``.touch`` file that has a tactile map."""
    return _with_medium(empty_map_page(), data, name)


def _with_medium(page: str, data: bytes, name: str) -> str:
    medium = _MEDIUM.replace('data-name=""', f'data-name="{html.escape(name)}"')
    return page.replace(_MEDIUM, medium.replace("><", f">{base64.b64encode(data).decode('ascii')}<"))
