"""A look at where a scene lies in the workspace, before anything is coded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.render.axes import BOX_AXES, axes_matrix
from touchfield.viewer.page import write_png
from touchfield.viewer.preview import PreviewSpec, draw_shadows, shadows

if TYPE_CHECKING:
    from touchfield.job.prepare import Prepared
    from touchfield.medium import HapticMedium

__all__ = ["draw_medium", "draw_preview"]

_FRAMES: Final = 3
"""Frames that are looked at: the first, the middle one and the last."""


def draw_preview(prepared: Prepared, path: str | Path) -> None:
    """Write a PNG of the forces in the workspace, seen from the viewer, from the side and from above.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    medium, placement = prepared.medium, prepared.placement
    frames = np.unique(np.linspace(0, len(medium) - 1, _FRAMES).astype(int)).tolist()
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


def draw_medium(medium: HapticMedium, path: str | Path | None = None) -> Any:
    """The forces of a medium as a matplotlib figure, as `draw_preview` shows them; a PNG, too, where `path` is given.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    frames = np.unique(np.linspace(0, len(medium) - 1, _FRAMES).astype(int)).tolist()
    title = f"frame{'s' * (len(frames) > 1)} {', '.join(map(str, frames))} of {len(medium)}, on the medium's lattice"
    spec = PreviewSpec(title, f"{medium.grid.words}; {medium.axes}", axes_matrix(BOX_AXES, medium.axes, "auto"))
    figure = shadows([medium[i] for i in frames], spec)
    if path is not None:
        write_png(figure, Path(path))
    return figure
