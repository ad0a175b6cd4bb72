"""Reports the range of a depth sequence in metres, and signs of another depth unit or encoding.

A wrong unit or bit order gives depth that is readable, and implausible: tens of metres in a room, or values
that use only some of their bits.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s
from touchfield.sources.camera import CodedSequence, DepthCode, DepthSequence

FAR_M: Final = 20.0  # a median depth beyond this is questioned,
FAR_ASSUMED_M: Final = 8.0  # and beyond this if the depth unit is only assumed
NEAR_M: Final = 0.05  # a median depth below this is questioned
USUAL_M: Final = (0.3, 6.0)  # median depth of a depth camera in use
UNITS: Final = {
    1000.0: "millimetres", 5000.0: "as in TUM", 10000.0: "0.1 mm", 4000.0: "0.25 mm", 100.0: "centimetres",
    1.0: "metres",
}  # fmt: skip
"""Usual numbers of stored units in a metre."""
ROTATED_FRACTION: Final = 0.97  # of the values, rotated by 3 bits, that have 0 or 1 in their low bits
PLAIN_FRACTION: Final = 0.5  # below this fraction, the bits are not rotated (a quarter by chance)
_MIN_VALUES = 64  # different values for a statement on bits
_SAMPLED_FRAMES = 3


def range_notes(sequence: DepthSequence) -> tuple[str, ...]:
    """Return the range of depth in a few frames, and what seems wrong with unit or encoding.

    Of a captured sequence, the first frame is used.
    """
    keys = [0] if sequence.is_captured else list(sequence.key_frames())
    keys = [keys[i * (len(keys) - 1) // (_SAMPLED_FRAMES - 1)] for i in range(_SAMPLED_FRAMES)]
    frames = sorted(set(keys))
    code = sequence.metres if isinstance(sequence, CodedSequence) else None
    if not isinstance(sequence, CodedSequence) or not isinstance(code, DepthCode):
        return range_note([sequence.depth_m(frame) for frame in frames])
    values = [sequence.frames.values(frame) for frame in frames]
    depth_m = [code(frame) for frame in values]
    notes = range_note(depth_m, code.units_per_m)
    stored = np.concatenate([frame[depth > 0] for frame, depth in zip(values, depth_m)])
    encoding = encoding_note(stored, code)
    return (*notes, *(encoding or unit_note(depth_m, code.units_per_m, sequence.is_unit_assumed)))


def range_note(depth_m: list[Float32s], units_per_m: float | None = None) -> tuple[str, ...]:
    """Return a note with the smallest, largest and median depth; none if no depth is known."""
    known = np.concatenate([depth[depth > 0] for depth in depth_m])
    if not len(known):
        return ()
    low, high, median = float(known.min()), float(known.max()), float(np.median(known))
    unit = "" if units_per_m is None else f", at {units_per_m:g} stored units in a metre"
    return (f"Depth is {low:.3g} to {high:.3g} m, median {median:.3g} m{unit}.",)


def unit_note(depth_m: list[Float32s], units_per_m: float, is_assumed: bool) -> tuple[str, ...]:
    """Return a note if the median depth is implausible, with the units that make it usual."""
    known = np.concatenate([depth[depth > 0] for depth in depth_m])
    median = float(np.median(known)) if len(known) else 1.0
    if NEAR_M <= median <= (FAR_ASSUMED_M if is_assumed else FAR_M):
        return ()
    side = "far" if median > NEAR_M else "near"
    likely = [
        f"--depth-scale {unit:g} ({name}) makes it {median * units_per_m / unit:.2g} m"
        for unit, name in UNITS.items()
        if USUAL_M[0] <= median * units_per_m / unit <= USUAL_M[1]
    ]
    mend = "; ".join(likely[:3]) or "check --depth-scale"
    return (f"A median depth of {median:.3g} m is too {side} for a depth camera indoors: {mend}.",)


def encoding_note(stored: NDArray[Any], code: DepthCode) -> tuple[str, ...]:
    """Return a note if stored values, of one dimension, do not use their bits as `code` assumes."""
    if stored.dtype.kind not in "ui" or stored.dtype.itemsize < 2 or not len(stored):
        return ()
    different = np.unique(stored)
    if _has_eight_bits(different):
        step_m = float(np.diff(different).min(initial=int(different[-1]))) / code.units_per_m
        return (
            f"The values have 8 bits only, so that depth has steps of {1000 * step_m:.3g} mm: give the "
            "pictures with all 16 bits.",
        )
    if len(different) < _MIN_VALUES:
        return ()
    fraction = float(((stored & 7) <= 1).mean())
    if code.is_rotated and fraction < PLAIN_FRACTION:
        return ("The bits of the values are not rotated, as those of SUN3D are: add --depth-encoding plain.",)
    is_shifted = not bool((different % 16).any())
    if not code.is_rotated and fraction >= ROTATED_FRACTION and not is_shifted:
        return (
            "The bits of the values seem rotated by 3, as in SUN3D and APC: add --depth-encoding rotated, "
            "with --depth-scale 1000 (SUN3D) or 10000 (APC).",
        )
    return ()


def _has_eight_bits(different: NDArray[Any]) -> bool:
    """Return True for up to 256 values that are multiples of 256 or 257, or all below 256."""
    is_picture = 16 <= len(different) <= 256
    return is_picture and (
        int(different[-1]) < 256 or not (different % 256).any() or not (different % 257).any()
    )
