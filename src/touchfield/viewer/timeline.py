"""Makes the HTML page that plays and edits the touch of a movie. Movie and touch are within the page.

The page itself, `web/timeline.html`, is built from the folder `web` of the repository (``make web``).
"""

from __future__ import annotations

import gzip
import html
from collections.abc import Mapping, Sequence
from typing import Any, Final

from touchfield.arrays import UInt8s
from touchfield.viewer.page_parts import built_page, filled, json_text

_TIMELINE: Final = '<script type="application/json" id="given-timeline">null</script>'
_DRIVES: Final = '<script type="text/plain" id="given-drives"></script>'
_MOVIE: Final = '<script type="text/plain" id="given-movie" data-type=""></script>'


def empty_timeline() -> str:
    """Return the page without a movie."""
    return built_page("timeline.html")


def timeline_page(
    description: Mapping[str, Any], tables: Sequence[UInt8s], movie: tuple[bytes, str] | None = None
) -> str:
    """Return the page with a movie and its touch.

    `description` has the device and the tracks. `tables` are the drives of their parts in order, uint8
    [frames, actuators] with 255 for a full drive, row by row from the top left. `movie` is a file that
    browsers play, and its media type; without it the touch plays alone.
    """
    drives = gzip.compress(b"".join(table.tobytes() for table in tables), mtime=0)
    film, kind = movie or (b"", "")
    start = _MOVIE.replace('data-type=""', f'data-type="{html.escape(kind)}"')
    page = empty_timeline().replace(_TIMELINE, _TIMELINE.replace("null", json_text(description)))
    return page.replace(_DRIVES, filled(_DRIVES, drives)).replace(_MOVIE, filled(start, film))
