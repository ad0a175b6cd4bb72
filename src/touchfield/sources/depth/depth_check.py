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
_MIN_VALUES = 64  # different values for a statement on their low bits,
_MIN_8_BIT_VALUES = 16  # and on all of them
_SAMPLED_FRAMES = 3
_SAMPLED_VALUES = 40_000  # of a frame, for medians and bits; the range is that of all values


def range_notes(sequence: DepthSequence) -> tuple[str, ...]:
    """Return the range of depth in a few frames, and what seems wrong with unit or encoding."""
    keys = list(sequence.key_frames())
    keys = [keys[i * (len(keys) - 1) // (_SAMPLED_FRAMES - 1)] for i in range(_SAMPLED_FRAMES)]
    frames = sorted(set(keys))
    code = sequence.metres if isinstance(sequence, CodedSequence) else None
    if not isinstance(sequence, CodedSequence) or not isinstance(code, DepthCode):
        return range_note([sequence.depth_m(frame) for frame in frames])
    return stored_notes([sequence.stored_values(frame) for frame in frames], code, sequence.is_unit_assumed)


def stored_notes(values: list[NDArray[Any]], code: DepthCode, is_assumed: bool) -> tuple[str, ...]:
    """Return the notes of `range_notes` for stored frames.

    `is_assumed` says that no file and no option states the unit.
    """
    depth_m = [code(frame) for frame in values]
    notes = range_note(depth_m, code.units_per_m)
    stored = np.concatenate([sampled(frame[depth > 0]) for frame, depth in zip(values, depth_m)])
    different = np.unique(stored) if stored.dtype.kind in "ui" else stored[:0]
    rotation = rotation_note(stored, code) if len(different) >= _MIN_VALUES else ()
    bits = eight_bits_note(different, code) if len(different) >= _MIN_8_BIT_VALUES else ()
    return (*notes, *bits, *(rotation or unit_note(depth_m, code.units_per_m, is_assumed)))


def range_note(depth_m: list[Float32s], units_per_m: float | None = None) -> tuple[str, ...]:
    """Return a note with the smallest, largest and median depth; none if no depth is known."""
    known = [values for depth in depth_m if len(values := depth[depth > 0])]
    if not known:
        return ()
    low, high = min(float(values.min()) for values in known), max(float(values.max()) for values in known)
    median = _median_m(known)
    unit = "" if units_per_m is None else f", at {units_per_m:g} stored units in a metre"
    where = f" in {len(depth_m)} frames" if len(depth_m) > 1 else ""
    return (f"Depth is {low:.3g} to {high:.3g} m{where}, median {median:.3g} m{unit}.",)


def sampled(values: NDArray[Any]) -> NDArray[Any]:
    """Return about `_SAMPLED_VALUES` of values [n], at equal distances; all of them if there are fewer."""
    return values[:: max(1, len(values) // _SAMPLED_VALUES)]


def _median_m(known: list[Float32s]) -> float:
    """Return the median of sampled depths; as float64, since two of them can have a sum beyond float32."""
    return float(np.median(np.concatenate([sampled(values) for values in known]).astype(np.float64)))


def unit_note(depth_m: list[Float32s], units_per_m: float, is_assumed: bool) -> tuple[str, ...]:
    """Return a note if the median depth is implausible, with the units that make it usual."""
    known = [values for depth in depth_m if len(values := depth[depth > 0])]
    median = _median_m(known) if known else 1.0
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


def rotation_note(stored: NDArray[Any], code: DepthCode) -> tuple[str, ...]:
    """Return a note if the bits of stored values, integers [n], are rotated, or not, against `code`.

    Values rotated by 3 have in their low bits the bits from 8192 on, which are mostly 0. Multiples of 16 have
    been shifted by more than that.
    """
    fraction, is_shifted = float(((stored & 7) <= 1).mean()), not bool((stored % 16).any())
    if code.is_rotated and fraction < PLAIN_FRACTION:
        return ("The bits of the values are not rotated, as those of SUN3D are: add --depth-encoding plain.",)
    if code.is_rotated or fraction < ROTATED_FRACTION or is_shifted:
        return ()
    return (
        "The bits of the values seem rotated by 3, as in SUN3D and APC: add --depth-encoding rotated, with "
        "--depth-scale 1000 (SUN3D) or 10000 (APC).",
    )


def eight_bits_note(different: NDArray[Any], code: DepthCode) -> tuple[str, ...]:
    """Return a note if the different stored values, ascending integers, are those of 8 bits.

    They are then multiples of 256 or 257, or all below 256.
    """
    if len(different) > 256 or (
        int(different[-1]) > 255 and (different % 256).any() and (different % 257).any()
    ):
        return ()
    step_mm = 1000 * float(np.diff(different).min()) / code.units_per_m
    return (
        f"The values have 8 bits only, so that depth has steps of {step_mm:.3g} mm: give the pictures with "
        "all 16 bits.",
    )
