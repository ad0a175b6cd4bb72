"""A stream, or a medium of the user's, as the page in the browser: one HTML file, in a notebook or by itself."""

from __future__ import annotations

import html
import tempfile
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any, Final

from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.job.compare import compare
from touchfield.job.encode import encode
from touchfield.job.spec import EncodeSpec, Report, silent
from touchfield.job.stream_scene import Source
from touchfield.medium import HapticMedium
from touchfield.medium.atomic import atomic_path
from touchfield.stream.mux import demux
from touchfield.stream.opened import OpenStream, open_stream
from touchfield.viewer.browser import page_of

__all__ = ["Page", "page_of_medium", "view"]

_MOST_FRAMES: Final = 30
"""Of a medium in memory, which is coded for the page."""

_HEIGHT_PX: Final = 640
_MOVIES: Final = {".mp4": "video/mp4", ".m4v": "video/mp4", ".mov": "video/mp4"}
_FIGURES: Final = ("mode", "promise_kept", "worst_mask_ratio", "worst_frame", "worst_voxel")
_COMPARED: Final = (
    "nmse_db", "worst_mask_ratio", "bits_per_supported_voxel", "entropy_voxel_bits", "hand_vibration_mn"
)  # fmt: skip


@dataclass(frozen=True)
class Page:
    """A page that shows a file, and figures that it tells beyond it; a notebook shows it as a cell's last value."""

    html: str
    figures: Mapping[str, Any]

    def __repr__(self) -> str:
        return f"<Page: {len(self.html):,} characters of HTML; .open() shows it, .save(path) keeps it>"

    def _repr_html_(self) -> str:
        style = f"width: 100%; height: {_HEIGHT_PX}px; border: 1px solid #d9dee6; border-radius: 8px"
        return f'<iframe srcdoc="{html.escape(self.html)}" style="{style}" title="touchfield"></iframe>'

    def save(self, path: str | Path) -> Path:
        """Write the page as one file that opens from a file URL, whole or not at all."""
        with atomic_path(Path(path)) as temporary:
            temporary.write_text(self.html, encoding="utf-8")
        return Path(path)

    def open(self, path: str | Path | None = None) -> Path:
        """Show the page in the browser, from a file where it was saved or a temporary one; where that is."""
        shown = Path(path) if path else self.save(Path(tempfile.mkdtemp(prefix="touchfield-")) / "page.html")
        webbrowser.open(shown.absolute().as_uri())
        return shown


def view(medium: str | Path | HapticMedium, against: Source | None = None, report: Report = silent) -> Page:
    """The page of a ``.touch`` file, of a movie with touch, or of the first frames of a medium.

    `against` is what was encoded, a path, Scene, medium or field: the page then tells NMSE, entropy and the vibration
    of the coding, too. TouchfieldError if the file cannot be read, or is of a coder that the page does not know.
    """
    if isinstance(medium, HapticMedium):
        return page_of_medium(medium)
    movie = Path(str(medium))
    if movie.suffix.lower() in _MOVIES:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{movie.stem}.touch"
            at_s = demux(movie, path).at_s
            return _page(path, against, report, (movie.read_bytes(), _MOVIES[movie.suffix.lower()], at_s))
    return _page(medium, against, report)


def _page(
    path: str | Path, against: Source | None, report: Report, movie: tuple[bytes, str, float] | None = None
) -> Page:
    with open_stream(path) as opened:
        coders = {opened.reader.head.coder, *_field_coders(opened)}
        if "paper" in coders:
            found, mend = "a file of coder paper", f"Code it again: touchfield encode {path} NEW.touch."
            raise InvalidArgument(str(path), found, "coder touch, or objects of it, for the page", mend)
        figures, data, name = _figures(opened), opened.reader.read_all(), PurePath(opened.reader.name).name
    if against is not None:
        told = compare(against, path, report=report).summary()
        figures |= {key: told[key] for key in _COMPARED if told.get(key) is not None}
    return Page(page_of(data, name, figures, movie), figures)


def page_of_medium(medium: HapticMedium) -> Page:
    """The page of a medium in memory: its first 30 frames, coded by coder `touch` with its least effort."""
    shown = medium if len(medium) <= _MOST_FRAMES else medium[:_MOST_FRAMES]
    spec = replace(EncodeSpec(), touch=TouchSpec(effort="fast"))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "medium.touch"
        encode(shown, out, spec)
        page = view(out)
    if shown is medium:
        return page
    return replace(page, figures={**page.figures, "frames_of": len(medium)})


def _figures(opened: OpenStream) -> dict[str, Any]:
    """What the stream itself promises, without decoding it."""
    told = opened.summary()
    return {key: told[key] for key in _FIGURES if told.get(key) is not None}


def _field_coders(opened: OpenStream) -> set[str]:
    """Coders of the fields of objects."""
    reader = opened.reader
    return {reader.read_object(i).field_coder for i in range(reader.object_count)}
