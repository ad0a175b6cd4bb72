"""Makes the HTML page that plays a ``.touch`` file in a browser, and the page of a tactile map. The file and
its decoder are within the page.

They need no network access. The pages themselves, `web/page.html` and `web/map.html`, are built from the
folder `web` of the repository (``make web``).
"""

from __future__ import annotations

import html
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from typing import Any, Final

from touchfield.viewer.page_parts import base64_text, built_page, filled, json_text

_FIGURES: Final = '<script type="application/json" id="given-figures">null</script>'
_MOVIE: Final = '<script type="text/plain" id="given-movie" data-type="" data-at="0"></script>'
_SOURCE: Final = '<script type="text/plain" id="given-source"></script>'
_MEDIUM: Final = '<script type="text/plain" id="given-medium" data-name=""></script>'


def empty_page() -> str:
    """Return the page without a file; the user drops or opens one."""
    return built_page("page.html")


def empty_map_page() -> str:
    """Return the page of maps without a file; the user drops or opens one."""
    return built_page("map.html")


@cache
def served_page() -> str:
    """Return the page that loads a file by name, or the live stream, from its own server."""
    page = built_page("from-server.html")
    for mark, element in (("@SCRIPT@", "script"), ("@STYLE@", "style")):
        text = page.partition(f"<{element}>")[2].partition(f"</{element}>")[0]
        page = page.replace(mark, f"'sha256-{base64_text(sha256(text.encode()).digest())}'")
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
    movie_element = _MOVIE
    if movie is not None:
        film, kind, at_s = movie
        movie_element = _MOVIE.replace(
            'data-type="" data-at="0"', f'data-type="{html.escape(kind)}" data-at="{at_s:.6f}"'
        )
        movie_element = filled(movie_element, film)
    figures_element = _FIGURES.replace("null", json_text(figures, str))
    page = empty_page().replace(_MOVIE, movie_element).replace(_FIGURES, figures_element)
    page = page.replace(_SOURCE, filled(_SOURCE, source))
    return _with_medium(page, data, name)


def map_page_of(data: bytes, name: str) -> str:
    """Return the page of maps with a ``.touch`` file that has a tactile map."""
    return _with_medium(empty_map_page(), data, name)


def _with_medium(page: str, data: bytes, name: str) -> str:
    medium = _MEDIUM.replace('data-name=""', f'data-name="{html.escape(name)}"')
    return page.replace(_MEDIUM, filled(medium, data))
