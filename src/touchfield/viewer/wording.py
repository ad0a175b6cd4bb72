"""Words on a picture: names come from files and are never formulas, and no line is wider than the page."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["add_title", "lines_that_fit", "shortened", "title_height_inch"]

_SIZE_PT = 11.0
_MARGIN_PT = 24.0
_LINE_INCH = 1.3 * _SIZE_PT / 72


def add_title(figure: Figure, text: str) -> None:
    """Put a title on a figure, in as many lines as its width asks for."""
    width_pt = 72 * float(figure.get_figwidth())
    figure.suptitle("\n".join(lines_that_fit(text, width_pt)), fontsize=_SIZE_PT, parse_math=False)


def title_height_inch(text: str, width_inch: float) -> float:
    """What the lines of a title take beyond its first."""
    return _LINE_INCH * (len(lines_that_fit(text, 72 * width_inch)) - 1)


def lines_that_fit(text: str, width_pt: float) -> list[str]:
    """Break a title at its blanks, and inside a word only where the word alone is wider than the page.

    Parameters
    ----------
    text : str
    width_pt : float
        Width of the page with its margins, points.

    Returns
    -------
    list of str
    """
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
