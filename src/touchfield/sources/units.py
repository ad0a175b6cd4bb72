"""Units that cannot be: a scene of kilometres or micrometres where rooms are usual, and the likely factor."""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.sources.scene import Scene

_FACTORS: Final = (1000.0, 100.0, 1e4, 1e6, 10.0)
"""Between units that are mistaken for each other, the usual first: metres and millimetres."""

_LIKELY_M: Final = (0.01, 20.0)  # usual sizes of things and rooms


def unit_notes(scene: Scene, start: int, stop: int) -> tuple[str, ...]:
    """A warning where frames start to stop - 1 are out of all proportion, with the factor that would mend it."""
    if scene.unit is None:
        return ()
    option, (low, high), is_divided = scene.unit
    size_m = float(np.ptp(scene.bounds_between_m(start, stop), axis=0).max())
    if low <= size_m <= high:
        return ()
    is_large = size_m > high
    sizes = [(factor, size_m / factor if is_large else size_m * factor) for factor in _FACTORS]
    factor, mended_m = next((s for s in sizes if _LIKELY_M[0] <= s[1] <= _LIKELY_M[1]), sizes[0])
    way = "larger" if is_large == is_divided else "smaller"
    return (
        f"Is the unit right? The scene measures {size_m:.3g} m across: with {option} {factor:g} times {way} it would "
        f"be {mended_m:.3g} m.",
    )
