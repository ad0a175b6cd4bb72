"""Axes of devices and fields (paper section 3.1, mapping M; "axes and handedness differ from device to device").

A driver says what its x, y, z are in words, "x right, y away from the user, z up", and so does a medium. Both are
held against one frame, that of the *box*: x right, y up, z towards the user.

What the words of a medium can tell. Its lattice was laid along the box whatever its axes mean
(`touchfield.filters.device_filter`): x along the width, y along the height, z along the depth, "so that a map hangs
before the user with its heights towards the hand". So its axes only say which way along each of them numbers grow:
the field of a camera, "x right, y down, z forward", is turned over twice and lies as it was seen. Words that would
lay an axis elsewhere, as those of a map ("x east, y north, z up"), change nothing where `up` is "lattice", and
neither do words that cannot be read; a note says so. Where `up` is "auto" they turn the field so that what they call
up is up for the hand; any axis can be named instead. The lattice keeps the extents that it was laid with.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.arrays import Float64s

BOX_AXES: Final = "x right, y up, z towards the user"

_STEMS: Final = {"right": (0, 1.0), "left": (0, -1.0), "up": (1, 1.0), "down": (1, -1.0), "back": (2, 1.0)}
_DIRECTIONS: Final = {
    **{stem + end: way for stem, way in _STEMS.items() for end in ("", "ward", "wards")},
    **dict.fromkeys(("towards", "toward"), (2, 1.0)),
    **dict.fromkeys(("away", "forward", "forwards"), (2, -1.0)),
}
"""Axis of the box and sign of a word."""

_UP_AXES: Final = {
    "x": "x up, y left, z towards",
    "-x": "x down, y right, z towards",
    "y": "x right, y up, z towards",
    "-y": "x right, y down, z away",
    "z": "x right, y away, z up",
    "-z": "x right, y towards, z down",
}
"""Lie of a field of which this axis is up, right-handed."""

UPS: Final = ("auto", "lattice", *_UP_AXES)
"""Choices of the axis that is up: as the words say, as the lattice was laid, or one by its name."""

_FILLING: Final = frozenset(("to", "the", "from", "user", "viewer", "hand"))
_LONGEST: Final = 256


def axes_of_text(text: str) -> Float64s | None:
    """A signed permutation P, float64 [3, 3], with v_box = P v; None if the text cannot be read.

    The text is such as "x right, y up, z towards the user", in any order and case, with or without "the user". The
    determinant is -1 for left-handed axes.
    """
    matrix, seen = np.zeros((3, 3)), set()
    if len(text) > _LONGEST:
        return None
    for part in text.lower().split(","):
        words = part.split()
        if not words or words[0] not in ("x", "y", "z") or words[0] in seen:
            return None
        seen.add(words[0])
        ways = [word for word in words[1:] if word not in _FILLING]
        if len(ways) != 1 or ways[0] not in _DIRECTIONS:
            return None
        axis, sign = _DIRECTIONS[ways[0]]
        matrix[axis, "xyz".index(words[0])] = sign
    return matrix if len(seen) == 3 and (np.abs(matrix).sum(axis=1) == 1).all() else None


def axes_matrix(device_axes: str, field_axes: str, up: str = "lattice") -> Float64s:
    """A signed permutation, float64 [3, 3]: what turns a vector in the device's axes into one in the field's.

    The axes are those of the profile (`touchfield.devices.Device.axes`) and of the medium; `up` is one of `UPS`. The
    determinant is -1 if the handedness differs.
    """
    device, field = axes_of_text(device_axes), _field(field_axes, up)
    matrix: Float64s = (field if field is not None else np.eye(3)).T @ (device if device is not None else np.eye(3))
    return matrix


def axes_notes(device_axes: str, field_axes: str, up: str = "lattice") -> tuple[str, ...]:
    """Notes for the user on how two texts were taken."""
    notes = []
    if axes_of_text(device_axes) is None:
        notes.append(f'axes of the device, "{device_axes[:80]}", are taken as {BOX_AXES}')
    if _field(field_axes, up) is None:
        notes.append(f'axes of the field, "{field_axes[:80]}", are laid along {BOX_AXES}')
    return tuple(notes)


def _field(field_axes: str, up: str) -> Float64s | None:
    """Lie of a medium in the box; of its lattice, the ways in which it grows: a diagonal of signs."""
    if up in _UP_AXES:
        return axes_of_text(_UP_AXES[up])
    if up == "auto":
        return axes_of_text(field_axes.replace("east", "right").replace("north", "away"))
    matrix = axes_of_text(field_axes)
    return matrix if matrix is not None and np.diagonal(matrix).all() else None
