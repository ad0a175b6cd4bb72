"""Media and plans to look at: as the page in the browser, one HTML file, and as pictures."""

from __future__ import annotations

import html
import math
import tempfile
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.touch.spec import TouchSpec
from touchfield.devices import device_names
from touchfield.errors import InvalidArgument
from touchfield.job.compare import compare
from touchfield.job.encode import encode
from touchfield.job.fine_source import fine_source
from touchfield.job.spec import EncodeSpec
from touchfield.job.stream_scene import Source
from touchfield.medium import HapticMedium
from touchfield.medium.atomic import atomic_path
from touchfield.parallel import Report, silent
from touchfield.render.axes import BOX_AXES, axes_matrix
from touchfield.stream.mux import demux
from touchfield.stream.opened import OpenStream, open_stream
from touchfield.viewer.browser import page_of
from touchfield.viewer.page import titled_figure, write_png
from touchfield.viewer.picture import PreviewSpec, draw_shadows, shadows

if TYPE_CHECKING:
    from touchfield.job.plan import Plan, Trial
    from touchfield.job.prepare import Prepared


_MOST_FRAMES: Final = 30
"""Of a medium in memory, which is coded for the page."""

_HEIGHT_PX: Final = 640
_MOVIES: Final = {".mp4": "video/mp4", ".m4v": "video/mp4", ".mov": "video/mp4"}
_FIGURES: Final = ("mode", "masking", "promise_kept", "worst_mask_ratio", "worst_frame", "worst_voxel")
_COMPARED: Final = (
    "nmse_db", "worst_mask_ratio", "bits_per_supported_voxel", "hand_vibration_mn",
    "place_tolerance_um",
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
        may = 'sandbox="allow-scripts" allow="gamepad *; vibrate *; autoplay *"'  # nothing of the notebook around it
        return f'<iframe srcdoc="{html.escape(self.html)}" {may} style="{style}" title="touchfield"></iframe>'

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


def view(
    medium: str | Path | HapticMedium,
    against: Source | None = None,
    report: Report = silent,
    devices: tuple[str, ...] = (),
) -> Page:
    """The page of a ``.touch`` file, of a movie with touch, or of the first frames of a medium.

    `against` is what was encoded, a path, Scene, medium or field: the page then tells NMSE and the vibration of the
    coding, and shows the source, and the difference, too; it holds both. `devices` are profiles whose capacity, WMR
    and HIL are told beside the entropy of the medium; where there is none of these, but a source, that of the
    stream. TouchfieldError if the file cannot be read, or is of a coder that the page does not know.
    """
    if isinstance(medium, HapticMedium):
        return page_of_medium(medium, devices)
    movie = Path(str(medium))
    if movie.suffix.lower() in _MOVIES:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{movie.stem}.touch"
            at_s = demux(movie, path).at_s
            film = movie.read_bytes(), _MOVIES[movie.suffix.lower()], at_s
            return _page(path, against, report, devices, film)
    return _page(medium, against, report, devices)


def _page(
    path: str | Path,
    against: Source | None,
    report: Report,
    devices: tuple[str, ...],
    movie: tuple[bytes, str, float] | None = None,
) -> Page:
    with open_stream(path) as opened:
        coders = {opened.reader.head.coder, *_field_coders(opened)}
        if "paper" in coders:
            found, mend = "a file of coder paper", f"Code it again: touchfield encode {path} NEW.touch."
            raise InvalidArgument(str(path), found, "coder touch, or objects of it, for the page", mend)
        figures, data, name = _figures(opened), opened.reader.read_all(), PurePath(opened.reader.name).name
        fine = None if against is None else fine_source(against, opened, report)
        own = _own_device(opened) if fine else ()
    try:
        if devices or own:
            figures |= _measured(path, devices or own)
    except InvalidArgument:  # such as a medium without any force
        if devices:
            raise
    if against is None or fine is None:
        return Page(page_of(data, name, figures, movie), figures)
    told = compare(against, path, report=report).summary()
    figures |= {key: told[key] for key in _COMPARED if told.get(key) is not None}
    figures |= {"source_bytes": len(fine.data), "source_share": fine.share}
    return Page(page_of(data, name, figures, movie, fine.data), figures)


def page_of_medium(medium: HapticMedium, devices: tuple[str, ...] = ()) -> Page:
    """The page of a medium in memory: its first 30 frames, coded by coder `touch` with its least effort."""
    shown = medium if len(medium) <= _MOST_FRAMES else medium[:_MOST_FRAMES]
    spec = replace(EncodeSpec(), touch=TouchSpec(effort="fast"))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "medium.touch"
        encode(shown, out, spec)
        page = view(out, devices=devices)
    if shown is medium:
        return page
    return replace(page, figures={**page.figures, "frames_of": len(medium)})


def _figures(opened: OpenStream) -> dict[str, Any]:
    """Promises of the stream itself, without decoding it."""
    told = opened.summary()
    return {key: told[key] for key in _FIGURES if told.get(key) is not None}


def _own_device(opened: OpenStream) -> tuple[str, ...]:
    """The profile that the stream was made for, where it is known here."""
    name = opened.reader.head.device_name
    return (name,) if name in device_names() else ()


def _measured(path: str | Path, devices: tuple[str, ...]) -> dict[str, Any]:
    """Entropy, and capacity by device, as `touchfield measure` tells them."""
    from touchfield.job.measure import MeasureSpec, measure_medium

    found = measure_medium(path, MeasureSpec(devices=devices, limits=False))
    rendered = {
        name: {"capacity_bits": c.capacity.value, "wmr": c.wmr.value, "hil": c.hil.value}
        for name, c in found.capacities.items()
    }
    return {
        "entropy_voxel_bits": found.voxel.value, "entropy_frame_bits": found.per_frame.value, "capacity": rendered
    }  # fmt: skip


def _field_coders(opened: OpenStream) -> set[str]:
    """Coders of the fields of objects."""
    reader = opened.reader
    return {reader.read_object(i).field_coder for i in range(reader.object_count)}


# -- pictures --------------------------------------------------------------------------------------------------------

_DRAWN_FRAMES: Final = 3
"""Frames that are looked at: the first, the middle one and the last."""

_COLOURS: Final = {
    "touch mask": "#0072b2",
    "touch mask-direction": "#009e73",
    "touch nmse": "#e69f00",
    "paper": "0.45",
}
_SHAPES: Final = "os^Dv<>p"
_SIZE_INCH: Final = (9.5, 5.6)


def draw_preview(prepared: Prepared, path: str | Path) -> None:
    """Write a PNG of the forces in the workspace, seen from the viewer, from the side and from above.

    MissingExtra if matplotlib is not installed.
    """
    medium, placement = prepared.medium, prepared.placement
    frames = np.unique(np.linspace(0, len(medium) - 1, _DRAWN_FRAMES).astype(int)).tolist()
    told = ", ".join(str(i) for i in frames)
    which = f"frame{'s' if len(frames) > 1 else ''} {told} of {len(medium)}"
    x, y, z = placement.offset_m
    up = "lattice" if prepared.device.is_array else "auto"  # as `play` lays it
    turn = axes_matrix(BOX_AXES, medium.axes, up)
    if (turn != axes_matrix(BOX_AXES, medium.axes)).any():
        which += f", {'xyz'[int(np.argmax(np.abs(turn[:, 1])))]} up for the hand"
    caption = f"{placement.wording}; the middle is the scene's ({x:.4g}, {y:.4g}, {z:.4g}) m; {medium.axes}"
    draw_shadows(
        Path(path),
        [medium[i] for i in frames],
        PreviewSpec(f"{which}, in the workspace of {prepared.device.name}", caption, turn),
    )


def draw_plan(path: Path, plan: Plan) -> None:
    """Write the picture of a plan as PNG: NMSE over the cost, a colour for each coder and mode, a shape a lattice.

    MissingExtra if matplotlib is not installed.
    """
    from touchfield.job.plan import amount

    chosen = plan.chosen
    title = f"{plan.source}: {chosen.options} for {amount(plan.budget, plan.unit)}"
    figure = titled_figure("the picture of a plan", title, *_SIZE_INCH)
    panel = figure.subplots()
    nws = sorted({t.spec.nw or 0 for t in plan.trials})
    drawn = [t for t in plan.trials if t.nmse > 0]
    for trial in drawn:
        shape = _SHAPES[nws.index(trial.spec.nw or 0) % len(_SHAPES)]
        panel.plot(plan.cost(trial), _db(trial), shape, ms=6, color=_COLOURS[trial.kind], zorder=2)
    front = [t for t in plan.front() if t.nmse > 0]
    panel.plot([plan.cost(t) for t in front], [_db(t) for t in front], color="black", lw=1, zorder=1)
    panel.axvline(plan.budget, color="0.3", lw=1, ls="--", zorder=0)
    if chosen.nmse > 0:
        at = plan.cost(chosen), _db(chosen)
        panel.plot(*at, "o", ms=15, mfc="none", mec="black", mew=1.6)
        cost = f"{amount(at[0], plan.unit)}, {100 * chosen.mask_kept:.1f} % in the mask"
        panel.annotate(f"{chosen.kind}, {chosen.options}\n{cost}", at, (12, 12), textcoords="offset points",
                       fontsize=8, parse_math=False)  # fmt: skip
    panel.set_xscale("log")
    panel.set_xlabel(f"{plan.unit} (dashed: the budget; line: the frontier; ring: the choice)", fontsize=8)
    panel.set_ylabel("NMSE, dB, against the finest lattice", fontsize=8)
    panel.tick_params(labelsize=8)
    panel.grid(color="0.92")
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)
    for kind in dict.fromkeys(t.kind for t in drawn):
        panel.plot([], [], "o", ms=6, color=_COLOURS[kind], label=kind)
    for i, nw in enumerate(nws):
        panel.plot([], [], _SHAPES[i % len(_SHAPES)], ms=6, color="0.2", mfc="none", label=f"nw {nw}")
    panel.legend(fontsize=8, frameon=False)
    write_png(figure, path)


def _db(trial: Trial) -> float:
    return 10 * math.log10(trial.nmse)


def draw_medium(medium: HapticMedium, path: str | Path | None = None) -> Any:
    """The forces of a medium as a matplotlib figure, as `draw_preview` shows them; a PNG, too, where `path` is given.

    MissingExtra if matplotlib is not installed.
    """
    frames = np.unique(np.linspace(0, len(medium) - 1, _DRAWN_FRAMES).astype(int)).tolist()
    title = f"frame{'s' * (len(frames) > 1)} {', '.join(map(str, frames))} of {len(medium)}, on the medium's lattice"
    spec = PreviewSpec(title, f"{medium.grid.words}; {medium.axes}", axes_matrix(BOX_AXES, medium.axes, "auto"))
    figure = shadows([medium[i] for i in frames], spec)
    if path is not None:
        write_png(figure, Path(path))
    return figure
