"""The page of a picture: its size, its title, and how it becomes a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from touchfield.errors import MissingExtra
from touchfield.medium.atomic import atomic_path
from touchfield.viewer.wording import add_title, title_height_inch

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

__all__ = ["is_our_picture", "titled_figure", "write_png"]

_DOTS_PER_INCH = 110
_HEAD_BYTES = 1 << 12


def titled_figure(purpose: str, title: str, width_inch: float, height_inch: float) -> Figure:
    """An empty figure below its title.

    Parameters
    ----------
    purpose : str
        What it is for, as an error says it: "the picture of a comparison".
    title : str
    width_inch, height_inch : float
        The height is that with a title of one line; more lines make the figure higher.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtra(purpose, "matplotlib", "report") from None
    height = height_inch + title_height_inch(title, width_inch)
    figure = Figure(figsize=(width_inch, height), dpi=_DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    add_title(figure, title)
    return figure


def write_png(figure: Figure, path: Path) -> None:
    """Write a figure, whole or not at all; its file tells who drew it (`is_our_picture`)."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        figure.savefig(file, format="png", metadata={"Creator": "touchfield"})


def is_our_picture(path: Path) -> bool:
    """A file that `write_png` wrote, and may write again."""
    with path.open("rb") as file:
        return b"Creator\0touchfield" in file.read(_HEAD_BYTES)
