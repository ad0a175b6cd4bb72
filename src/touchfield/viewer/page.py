"""Makes matplotlib figures with a title and writes them as PNG files, for all pictures of this package."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING, Any

from touchfield.atomic import atomic_path
from touchfield.errors import import_extra, require_ending

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure


_DOTS_PER_INCH = 110
_HEAD_BYTES = 1 << 12
_SIZE_PT = 11.0
_LINE_INCH = 1.3 * _SIZE_PT / 72
_LETTERS_PER_INCH = 9.0  # of text of that size, with a margin: the mean is 11


def require_matplotlib(purpose: str) -> None:
    """Raise MissingExtra, which names the `purpose`, if matplotlib is not installed."""
    import_extra("matplotlib", purpose, "matplotlib", "report")


def titled_figure(purpose: str, title: str, width_inch: float, height_inch: float) -> Figure:
    """Return an empty figure with a title.

    `height_inch` is the height of the figure with a title of one line. Raises MissingExtra, which names the
    `purpose` ("the picture of a comparison"), if matplotlib is not installed.
    """
    require_matplotlib(purpose)
    from matplotlib.figure import Figure

    lines = lines_that_fit(title, width_inch)
    height = height_inch + _LINE_INCH * (len(lines) - 1)
    figure = Figure(figsize=(width_inch, height), dpi=_DOTS_PER_INCH, layout="constrained")
    figure.suptitle("\n".join(lines), fontsize=_SIZE_PT, parse_math=False)
    return figure


def write_png(figure: Figure, path: Path) -> None:
    """Write a figure atomically, as PNG.

    The file names touchfield as its creator (see `is_our_picture`). Raises InvalidArgument unless the name
    ends in .png.
    """
    require_ending(path, "PICTURE.png")
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with atomic_path(path) as temporary, temporary.open("wb") as file:  # savefig would draw all twice
        canvas: Any = FigureCanvasAgg(figure)
        canvas.print_png(file, metadata={"Creator": "touchfield"})


def is_our_picture(path: Path) -> bool:
    """Return True if `write_png` wrote a file, and may overwrite it."""
    with path.open("rb") as file:
        return b"Creator\0touchfield" in file.read(_HEAD_BYTES)


def lines_that_fit(text: str, width_inch: float) -> list[str]:
    """Break a title into lines for a width, at blanks and within words longer than a line."""
    count = int(_LETTERS_PER_INCH * width_inch)
    return [line for part in text.split("\n") for line in wrap(part, count) or [""]]
