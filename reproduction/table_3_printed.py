"""Contains the figures that the paper prints in table 3, and computes which of them are impossible."""

from __future__ import annotations

from typing import Final

from reproduction.experiment import markdown_table
from reproduction.trends import Case, Point, bounds

__all__ = ["FRACTIONS", "FRAME_COUNTS", "PRINTED", "impossibility"]

FRACTIONS: Final = (0.01, 0.1, 0.25)
"""k."""

FRAME_COUNTS: Final = (1, 2, 5)
"""m."""

_ROWS = (  # m, k, CR and NMSE of 258 directions, CR and NMSE of 92
    (1, 0.01, 0.0669, -36.6375, 0.0623, -33.3948),
    (1, 0.1, 0.0260, -34.6063, 0.0241, -31.3030),
    (1, 0.25, 0.0138, -32.9836, 0.0129, -29.7378),
    (2, 0.01, 0.0071, -33.8212, 0.0063, -31.8455),
    (2, 0.1, 0.0042, -32.7541, 0.0039, -30.6527),
    (2, 0.25, 0.0027, -31.8516, 0.0024, -29.5160),
    (5, 0.01, 0.0047, -34.5251, 0.0042, -31.9799),
    (5, 0.1, 0.0020, -33.1267, 0.0018, -30.2778),
    (5, 0.25, 9.5580e-04, -31.7388, 8.8290e-04, -28.4904),
)

PRINTED: Final[dict[Case, Point]] = {
    Case(m, k, is_high): Point(*(high if is_high else low))
    for m, k, *values in _ROWS
    for high, low in [(values[:2], values[2:])]
    for is_high in (True, False)
}
"""Compression ratio and NMSE in dB by setting."""


def impossibility() -> str:
    """What cannot be among the printed multi-frame figures, computed from the figures themselves, as
    Markdown.
    """
    found = bounds(PRINTED)
    rows = [
        [
            b.case.wording,
            f"{b.cr:.5f}",
            f"{b.least_cr:.5f}",
            f"{b.least_cr / b.cr:.1f}",
            _possible(b.is_possible),
        ]
        for b in found
    ]
    fewer = [
        f"at k = {k:g} with {'high' if is_high else 'low'} directions, m CR falls from "
        f"{2 * PRINTED[Case(2, k, is_high)].cr:.5f} (m = 2) to {5 * PRINTED[Case(5, k, is_high)].cr:.5f} (m "
        "= 5)"
        for is_high in (True, False)
        for k in FRACTIONS
        if 5 * PRINTED[Case(5, k, is_high)].cr < 2 * PRINTED[Case(2, k, is_high)].cr
    ]
    below = sum(not b.is_possible for b in found)
    text = (
        "Eq. 9 divides the bits of all m frames by m frames' raw bits. The first frame is sent like a single "
        "one, "
        "so that CR(m) is CR(1) / m at the least, even if all later frames cost nothing. "
        f"Of the {len(found)} printed multi-frame figures {below} are below that.\n\n"
    )
    text += markdown_table(["setting", "printed CR", "CR(1) / m", "times too small", ""], rows)
    if fewer:
        text += (
            "\nNor do they count differences alone, without the first frame: five frames hold four "
            "differences, two "
            "hold one, and yet the total number of bits, m CR in units of a raw frame, goes down: "
            f"{'; '.join(fewer)}. The multi-frame rows must come of other settings or other data than the "
            "single-frame rows; the text does not say which.\n"
        )
    return text


def _possible(is_possible: bool) -> str:
    return "possible" if is_possible else "not possible"
