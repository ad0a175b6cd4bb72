"""Makes the HTML page that plays and edits the touch of a movie. Movie and touch are within the page.

The page itself, `web/timeline.html`, is built from the folder `web` of the repository (``make web``).
"""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any, Final

from touchfield.arrays import UInt8s

_TIMELINE: Final = '<script type="application/json" id="given-timeline">null</script>'
_DRIVES: Final = '<script type="text/plain" id="given-drives"></script>'
_MOVIE: Final = '<script type="text/plain" id="given-movie" data-type=""></script>'


@cache
def empty_timeline() -> str:
    """Return the page without a movie."""
    return resources.files("touchfield.viewer").joinpath("web/timeline.html").read_text(encoding="utf-8")


def timeline_page(
    description: Mapping[str, Any], tables: Sequence[UInt8s], movie: tuple[bytes, str] | None = None
) -> str:
    """Return the page with a movie and its touch.

    `description` has the device and the tracks. `tables` are the drives of their parts in order, uint8
    [frames, actuators] with 255 for a full drive, row by row from the top left. `movie` is a file that
    browsers play, and its media type; without it the touch plays alone.
    """
    text = json.dumps(description).replace("<", "\\u003c")  # untrusted text cannot close the element
    drives = _base64(gzip.compress(b"".join(table.tobytes() for table in tables), mtime=0))
    film, kind = movie or (b"", "")
    start = _MOVIE.replace('data-type=""', f'data-type="{html.escape(kind)}"')
    page = empty_timeline().replace(_TIMELINE, _TIMELINE.replace("null", text))
    page = page.replace(_DRIVES, _DRIVES.replace("><", f">{drives}<"))
    return page.replace(_MOVIE, start.replace("><", f">{_base64(film)}<"))


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")
