"""The page of a picture: its size, its title, and how it becomes a file."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from touchfield.errors import MissingExtra
from touchfield.medium.atomic import atomic_path

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure


_DOTS_PER_INCH = 110
_HEAD_BYTES = 1 << 12
_SIZE_PT = 11.0
_MARGIN_PT = 24.0
_LINE_INCH = 1.3 * _SIZE_PT / 72


def titled_figure(purpose: str, title: str, width_inch: float, height_inch: float) -> Figure:
    """An empty figure below its title; more lines than one make it higher than `height_inch`.

    `purpose` as an error says it, "the picture of a comparison": `MissingExtra` if matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtra(purpose, "matplotlib", "report") from None
    lines = lines_that_fit(title, 72 * width_inch)
    height = height_inch + _LINE_INCH * (len(lines) - 1)
    figure = Figure(figsize=(width_inch, height), dpi=_DOTS_PER_INCH, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle("\n".join(lines), fontsize=_SIZE_PT, parse_math=False)
    return figure


def write_png(figure: Figure, path: Path) -> None:
    """Write a figure, whole or not at all; its file tells who drew it (`is_our_picture`)."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        figure.savefig(file, format="png", metadata={"Creator": "touchfield"})


def is_our_picture(path: Path) -> bool:
    """A file that `write_png` wrote, and may write again."""
    with path.open("rb") as file:
        return b"Creator\0touchfield" in file.read(_HEAD_BYTES)


def lines_that_fit(text: str, width_pt: float) -> list[str]:
    """Break a title at its blanks, and inside a word only where it alone is wider than the page with its margins."""
    room = width_pt - _MARGIN_PT
    lines = []
    for given in text.split("\n"):
        line = ""
        for word in given.split(" "):
            longer = f"{line} {word}" if line else word
            if _width_pt(longer) <= room:
                line = longer
                continue
            if line:
                lines.append(line)
            line = word
            while _width_pt(line) > room:
                count = _count_that_fits(line, room)
                lines.append(line[:count])
                line = line[count:]
        lines.append(line)
    return lines


def shortened(text: str, most: int) -> str:
    """The begin and the end of a name that has more than `most` characters."""
    if len(text) <= most:
        return text
    head = (most - 1) // 2
    return f"{text[:head]}\u2026{text[len(text) - (most - 1 - head) :]}"


def _count_that_fits(word: str, room: float) -> int:
    """The most characters, at least one, that are not wider than `room`."""
    low, high = 1, len(word)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if _width_pt(word[:middle]) <= room else (low, middle - 1)
    return low


def _width_pt(text: str) -> float:
    measure, font = _measure()
    return float(measure(text, font, ismath=False)[0]) if text else 0.0


@cache
def _measure() -> tuple[Any, Any]:
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    return text_to_path.get_text_width_height_descent, FontProperties(size=_SIZE_PT)
