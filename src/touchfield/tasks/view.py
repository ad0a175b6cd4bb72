"""Makes what a user looks at: the page for browsers, which is one HTML file, and pictures of a medium."""

from __future__ import annotations

import html
import shlex
import tempfile
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.atomic import atomic_path
from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute.threads import Progress, silent
from touchfield.devices import device_names
from touchfield.errors import FormatError, InvalidArgument, require_one_of
from touchfield.files import is_remote
from touchfield.medium import HapticMedium
from touchfield.network.demux import demux
from touchfield.network.opening import open_stream
from touchfield.pipeline.comparison import compare, source_medium
from touchfield.pipeline.encoding import encode, encode_prepared
from touchfield.pipeline.preparation import Prepared
from touchfield.pipeline.source import Source
from touchfield.pipeline.spec import EncodeSpec
from touchfield.pipeline.stream import OpenStream
from touchfield.render.point_device import BOX_AXES, axes_matrix
from touchfield.tasks.measure import MeasureSpec, measure_medium
from touchfield.tasks.timeline_view import is_for_array, movie_bytes, view_timeline
from touchfield.tasks.touch_tracks import PLAYED_MOVIES, is_movie
from touchfield.viewer.browser import map_page_of, page_of
from touchfield.viewer.page import write_png
from touchfield.viewer.picture import shadows

_MAX_FRAMES: Final = 30  # frames of a medium in memory that are coded for the page
_HEIGHT_PX: Final = 640
PAGES: Final = ("auto", "field", "map", "timeline")
_DRAWN_FRAMES: Final = 3  # the first, the middle one and the last
MAX_SOURCE_BYTES: Final = 1 << 25  # maximum size of the source within a page
_ERROR_FRACTIONS: Final = (0.1, 0.3)
_MIN_K: Final = 1e-3
_SUMMARY_KEYS: Final = ("mode", "masking", "promise_kept", "worst_mask_ratio", "worst_frame", "worst_voxel")
_COMPARISON_KEYS: Final = (
    "nmse_db", "worst_mask_ratio", "bits_per_supported_voxel", "hand_vibration_mn",
    "place_tolerance_um",
)  # fmt: skip


@dataclass(frozen=True)
class Page:
    """A page that shows a file, and additional figures.

    A notebook displays it as the last value of a cell.
    """

    html: str
    figures: Mapping[str, Any]

    def __repr__(self) -> str:
        return f"<Page: {len(self.html):,} characters of HTML; .open() shows it, .save(path) keeps it>"

    def _repr_html_(self) -> str:
        style = f"width: 100%; height: {_HEIGHT_PX}px; border: 1px solid #d9dee6; border-radius: 8px"
        # without access to the notebook
        permissions = 'sandbox="allow-scripts" allow="gamepad *; vibrate *; autoplay *"'
        attributes = f'{permissions} style="{style}" title="touchfield"'
        return f'<iframe srcdoc="{html.escape(self.html)}" {attributes}></iframe>'

    def save(self, path: str | Path) -> Path:
        """Write the page atomically as one file that opens from a file URL."""
        with atomic_path(Path(path)) as temporary:
            temporary.write_text(self.html, encoding="utf-8")
        return Path(path)

    def open(self, path: str | Path | None = None) -> Path:
        """Show the page in the browser; return the path of its file.

        The file is `path`, or a temporary one.
        """
        page_path = (
            Path(path) if path else self.save(Path(tempfile.mkdtemp(prefix="touchfield-")) / "page.html")
        )
        webbrowser.open(page_path.absolute().as_uri())
        return page_path


def view(
    medium: str | Path | HapticMedium,
    against: Source | None = None,
    report: Progress = silent,
    devices: tuple[str, ...] = (),
    page: str = "auto",
) -> Page:
    """Return the page of a ``.touch`` file, of a movie with touch, or of a medium.

    Of a medium, the first 30 frames are shown. Of a movie in Matroska, MPEG-TS or HLS only the touch is
    shown, and a note says how to see its pictures. `against` is the source that was encoded: a path, scene,
    medium or field. The page then contains it, shows it and the difference, and states the NMSE and the
    vibration of the coding. `devices` are profiles whose capacity, WMR and HIL are shown with the entropy of
    the medium; with a source and no profile, that of the stream. `page` is one of `PAGES`: the page of the
    field, that of a tactile map, or the one that plays and edits the touch of a movie on a timeline; "auto"
    takes the map of a file that has one and the timeline for a movie whose touch is for an array, without
    `against` and `devices`. Raises TouchfieldError if the file cannot be read, or the page does not support
    its coder.
    """
    require_one_of("--page", page, PAGES)
    if page == "timeline":
        return _timeline(medium, against, devices, report)
    if page == "map":
        return _required_map_page(medium, against, devices)
    with tempfile.TemporaryDirectory() as folder:
        if isinstance(medium, HapticMedium):
            path, spec = Path(folder) / "medium.touch", EncodeSpec(touch=TouchSpec(effort="fast"))
            encode(medium[:_MAX_FRAMES], path, spec)
            shown = _page(path, against, report, devices)
            extra_figures = {"frames_of": len(medium)} if len(medium) > _MAX_FRAMES else {}
            return replace(shown, figures={**shown.figures, **extra_figures})
        movie = Path(str(medium))
        kind = PLAYED_MOVIES.get(movie.suffix.lower())
        if is_remote(medium) or not is_movie(movie):
            is_plain = page == "auto" and against is None and not devices
            map_page, notes = _map_page(medium) if is_plain else (None, [])
            if map_page is not None:
                return map_page
            shown = _page(medium, against, report, devices)
            return replace(shown, figures={**shown.figures, **({"map_notes": notes} if notes else {})})
        path = Path(folder) / f"{movie.stem}.touch"
        done = demux(movie, path)
        if page == "auto" and against is None and not devices and is_for_array(path):
            return _timeline(movie, None, (), report)
        film = None if kind is None else (movie_bytes(movie), kind, done.at_s)
        shown = _page(path, against, report, devices, film)
        notes = [*done.notes, *((_without_pictures(movie, done.at_s),) if kind is None else ())]
        return replace(shown, figures={**shown.figures, **({"movie_notes": notes} if notes else {})})


def _timeline(
    medium: str | Path | HapticMedium, against: Source | None, devices: tuple[str, ...], report: Progress
) -> Page:
    """The page that edits the touch of a movie, or of a ``.touch`` file without picture."""
    if not isinstance(medium, HapticMedium) and is_remote(medium):
        raise InvalidArgument("--page timeline", "an address", "a file", "Download it first.")
    movie = Path(_required_file("timeline", medium, against, devices, "a movie with touch, or a .touch file"))
    shown = view_timeline(movie, PLAYED_MOVIES.get(movie.suffix.lower()), report)
    return Page(shown.html, shown.figures)


def _map_page(path: str | Path) -> tuple[Page | None, list[str]]:
    """Return the page of the tactile map in a file, and notes; None if it has none that can be read."""
    with open_stream(path) as opened:
        reader = opened.reader
        if not reader.has_map:
            return None, []
        try:
            record = reader.read_map()
        except FormatError as error:  # the frame is shown nevertheless
            return None, [f"the map is not shown: {error}"]
        data, name = reader.read_all(), PurePath(reader.name).name
    if record is None:
        return None, []
    figures = {
        "title": record.title,
        "zoom_levels": len(record.levels),
        "views": len(record.views),
        "named_features": len(record.places),
    }
    return Page(map_page_of(data, name), figures), []


def _required_map_page(
    medium: str | Path | HapticMedium, against: Source | None, devices: tuple[str, ...]
) -> Page:
    """Return the page of the tactile map in a file; raises InvalidArgument if it has none."""
    expected = "a .touch file of touchfield map"
    path = _required_file("map", medium, against, devices, expected)
    shown, notes = _map_page(path)
    if shown is None:
        found = notes[0] if notes else "a file without a map"
        raise InvalidArgument(f"--page map: {medium}", found, expected)
    return shown


def _required_file(
    page: str,
    medium: str | Path | HapticMedium,
    against: Source | None,
    devices: tuple[str, ...],
    expected: str,
) -> str | Path:
    """Return the file that a page other than the field's shows; InvalidArgument if it cannot be shown so."""
    if isinstance(medium, HapticMedium):
        raise InvalidArgument(f"--page {page}", "a medium in memory", expected)
    if against is not None or devices:
        hint = "Take them out, or show the page of the field: --page field."
        raise InvalidArgument(f"--page {page}", "--source or --device", "neither", hint)
    return medium


def _without_pictures(movie: Path, at_s: float) -> str:
    """Say why the pictures of a movie, whose touch begins at `at_s`, are not shown, and how to see them."""
    touch, film = f"{movie.stem}.touch", f"{movie.stem}.mp4"
    muxed = ("mux", str(movie), touch, film, "--at-s", f"{at_s:.6g}")
    commands = (("demux", str(movie), touch), muxed, ("view", film))
    how = "; ".join(shlex.join(["touchfield", *words]) for words in commands)
    return f"only the touch of the movie is shown, as not every browser plays {movie.suffix}: {how}"


def _page(
    path: str | Path,
    against: Source | None,
    report: Progress,
    devices: tuple[str, ...],
    movie: tuple[bytes, str, float] | None = None,
) -> Page:
    with open_stream(path) as opened:
        reader = opened.reader
        coders = [reader.head.coder, *(reader.read_object(i).field_coder for i in range(reader.object_count))]
        if "paper" in coders:
            found, hint = (
                "a file of coder paper",
                f"Code it again: touchfield encode {shlex.quote(str(path))} NEW.touch.",
            )
            raise InvalidArgument(str(path), found, "coder touch, or objects of it, for the page", hint)
        summary, data, name = opened.summary(), reader.read_all(), PurePath(reader.name).name
        figures = {key: summary[key] for key in _SUMMARY_KEYS if summary.get(key) is not None}
        fine = None if against is None else fine_source(against, opened, report)
        device = reader.head.device_name
        stream_devices = (device,) if fine and device in device_names() else ()
    try:
        if devices or stream_devices:
            measured = measure_medium(path, MeasureSpec(devices=devices or stream_devices, limits=False))
            figures |= {
                "entropy_voxel_bits": measured.voxel.value,
                "entropy_frame_bits": measured.per_frame.value,
                "capacity": {
                    name: {"capacity_bits": c.capacity.value, "wmr": c.wmr.value, "hil": c.hil.value}
                    for name, c in measured.capacities.items()
                },
            }
    except InvalidArgument:  # such as a medium without any force
        if devices:
            raise
    if against is None or fine is None:
        return Page(page_of(data, name, figures, movie), figures)
    figures_of_source = compare(against, path, report=report).summary()
    figures |= {
        key: figures_of_source[key] for key in _COMPARISON_KEYS if figures_of_source.get(key) is not None
    }
    figures |= {"source_bytes": len(fine.data), "source_share": fine.error_fraction}
    return Page(page_of(data, name, figures, movie, fine.data), figures)


def draw_preview(prepared: Prepared, path: str | Path) -> None:
    """Write a PNG of the forces in the workspace, from the viewer, the side and above.

    Raises MissingExtra if matplotlib is not installed.
    """
    medium, placement = prepared.medium, prepared.placement
    x, y, z = placement.offset_m
    up = "lattice" if prepared.device.is_array else "auto"  # as `play` places it
    permutation = axes_matrix(BOX_AXES, medium.axes, up)
    where = f"in the workspace of {prepared.device.name}"
    if (permutation != axes_matrix(BOX_AXES, medium.axes)).any():
        where = f"{'xyz'[int(np.argmax(np.abs(permutation[:, 1])))]} up for the hand, {where}"
    caption = f"{placement.wording}; the middle is the scene's ({x:.4g}, {y:.4g}, {z:.4g}) m; {medium.axes}"
    write_png(_shadows(medium, where, caption, permutation), Path(path))


def draw_medium(medium: HapticMedium, path: str | Path | None = None) -> Any:
    """Draw the forces of a medium as a matplotlib figure; also a PNG if `path` is given.

    The views are those of `draw_preview`, cropped to the samples with forces. Raises MissingExtra if
    matplotlib is not installed.
    """
    turn = axes_matrix(BOX_AXES, medium.axes, "auto")
    caption = f"{medium.grid.description}; {medium.axes}"
    figure = _shadows(medium, "cropped to the forces; edges of the lattice", caption, turn, is_cropped=True)
    if path is not None:
        write_png(figure, Path(path))
    return figure


def _shadows(
    medium: HapticMedium, where: str, caption: str, permutation: Float64s, *, is_cropped: bool = False
) -> Any:
    """Draw the first, the middle and the last frame of a medium."""
    frames = np.unique(np.linspace(0, len(medium) - 1, _DRAWN_FRAMES).astype(int)).tolist()
    title = (
        f"frame{'s' * (len(frames) > 1)} {', '.join(str(n + 1) for n in frames)} of {len(medium)}, {where} "
        "(dashed)"
    )
    return shadows([medium[i] for i in frames], f"{title}\n{caption}", permutation, is_cropped=is_cropped)


class FineSource(NamedTuple):
    """A source as the bytes of a ``.touch`` file, and its error.

    `error_fraction` is the error bound of the source as a fraction of the stream's error bound.
    """

    data: bytes
    error_fraction: float


def fine_source(source: Source, opened: OpenStream, report: Progress = silent) -> FineSource:
    """Code the source of a stream on its lattice, within a tenth of its mask.

    If the result is too large, three tenths are used. Raises InvalidArgument if the source has another
    lattice or other frames, or takes more than `MAX_SOURCE_BYTES`.
    """
    head, original = opened.reader.head, source_medium(source, opened)
    size = 0
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "source.touch"
        for fraction in _ERROR_FRACTIONS:
            k = min(max(fraction * head.weber_fraction, _MIN_K), 0.999)
            spec = EncodeSpec(touch=TouchSpec(k=k, f0_n=fraction * head.force_threshold_n, effort="fast"))
            prepared = Prepared(
                original.medium,
                opened.declared_device,
                opened.placement,
                spec,
                original.notes,
                original.objects,
            )
            size = encode_prepared(prepared, out, {}, report).file_bytes
            if size <= MAX_SOURCE_BYTES:
                return FineSource(out.read_bytes(), max(fraction, k / max(head.weber_fraction, k)))
    hint = "Leave it out, or take fewer frames."
    raise InvalidArgument(
        "the source", f"{size:,} bytes, coded finely", f"at most {MAX_SOURCE_BYTES:,} in a page", hint
    )
