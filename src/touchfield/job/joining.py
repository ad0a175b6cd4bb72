"""Stored media read, and brought to the lattice, the rate and the axes of others (paper section 4, "haptic editing").

Between two frames a medium is linear, as a receiver blends it; between two lattices lies the resampler's low-pass.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.device_filter import NW_RANGE
from touchfield.filters.region import RigidMotion
from touchfield.filters.resample import LOW_PASSES, interpolated, resample
from touchfield.job.prepare import Prepared, prepare
from touchfield.job.spec import EncodeSpec
from touchfield.job.stream_scene import is_stream
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.render.point_device import axes_matrix
from touchfield.sources.registry import open_source

KERNELS: Final = (*LOW_PASSES, "trilinear")


def read_medium(path: str | Path, spec: EncodeSpec | None = None) -> Prepared:
    """A .touch file, or a stored field on its own lattice.

    InvalidArgument if the source is no medium yet.
    """
    if is_stream(path):
        return prepare(path, spec)
    stored = getattr(open_source(path), "medium", None)
    if not isinstance(stored, HapticMedium):
        raise InvalidArgument(
            str(path), "a scene", "a .touch file or a stored field", "Make it a medium: touchfield encode."
        )
    return prepare(stored, spec)


def spread(count: int, most: int) -> list[int]:
    """At most so many of the numbers below `count`, evenly spaced."""
    places: list[int] = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int)).tolist()
    return places


def taken(medium: HapticMedium, places: Sequence[int]) -> HapticMedium:
    """Some of the frames of a medium, one after the other."""
    count, band = len(places), medium.vibration
    if band is not None:
        band = replace(band, frame_count=count, make_frame=[band[i] for i in places].__getitem__)
    return replace(medium, frame_count=count, make_frame=lambda i: medium[places[i]], vibration=band, segments=None)


def with_history(medium: HapticMedium, key: str, words: str) -> Mapping[str, str]:
    """The provenance of a medium with what is done to it now."""
    before = medium.provenance.get(key)
    return MappingProxyType({**medium.provenance, key: f"{before}; {words}" if before else words})


def retimed(medium: HapticMedium, rate_hz: float) -> HapticMedium:
    """The medium at another rate, linear between its frames; its duration stays to within half a frame."""
    if medium.rate_hz == rate_hz:
        return medium
    if not 0 < rate_hz < math.inf:
        raise InvalidArgument("rate_hz", repr(rate_hz), "frames a second, more than 0")
    near = replace(medium, make_frame=lru_cache(2)(medium.__getitem__))  # a frame serves several that are asked for
    count = max(1, round(len(medium) * rate_hz / medium.rate_hz))
    words = with_history(medium, "resampled", f"{medium.rate_hz:g} Hz to {rate_hz:g} Hz")
    return replace(
        medium, rate_hz=rate_hz, frame_count=count, make_frame=lambda i: near.at(i / rate_hz), vibration=None,
        segments=None, provenance=words,
    )  # fmt: skip


def resampled(medium: HapticMedium, grid: Grid, kernel: str = "spline") -> HapticMedium:
    """The medium on another lattice through a low-pass, or "trilinear" between its samples."""
    if kernel not in KERNELS:
        raise InvalidArgument("kernel", repr(kernel), f"one of {', '.join(KERNELS)}")
    if grid == medium.grid:
        return medium

    def make(i: int) -> ForceField:
        return interpolated(medium[i], grid) if kernel == "trilinear" else resample(medium[i], grid, kernel)

    words = with_history(medium, "resampled", f"{medium.grid.words} to {grid.words}, {kernel}")
    return replace(medium, grid=grid, make_frame=make, vibration=None, segments=None, provenance=words)


def joined(
    medium: HapticMedium, like: HapticMedium, kernel: str = "spline", name: str = "the medium"
) -> tuple[HapticMedium, tuple[str, ...]]:
    """A medium in the axes, on the lattice and at the rate of another one, and notes on what that took."""
    notes: list[str] = []
    made = medium
    turn = axes_matrix(medium.axes, like.axes)
    if (turn != np.eye(3)).any():
        motion, before = RigidMotion(tuple(map(tuple, turn.tolist()))), made  # type: ignore[arg-type]
        box = np.sort(motion.points_m(np.stack(medium.grid.box_m)), axis=0)
        shape = tuple(np.abs(turn @ np.array(medium.grid.shape)).astype(int).tolist())
        grid = Grid.over_box(box[0], box[1], shape)
        made = replace(
            made, grid=grid, axes=like.axes, make_frame=lambda i: interpolated(before[i], grid, motion),
            vibration=None, segments=None,
        )  # fmt: skip
        notes.append(f"{name}: turned from {medium.axes} to {like.axes}")
    if made.grid != like.grid:
        notes.append(f"{name}: {made.grid.words} resampled to {like.grid.words}")
        lost = _outside(made[len(made) // 2], like.grid)
        if lost:
            notes.append(f"{name}: {100 * lost:.3g} % of its samples lie outside, and are left out")
        made = resampled(made, like.grid, kernel)
    if made.rate_hz != like.rate_hz:
        notes.append(f"{name}: {made.rate_hz:g} Hz to {like.rate_hz:g} Hz")
        made = retimed(made, like.rate_hz)
    return replace(made, axes=like.axes), tuple(notes)


def _outside(field: ForceField, grid: Grid) -> float:
    """The share of the supported samples that lie beyond a grid's box."""
    places = field.grid.to_m(field.positions())
    low, high = grid.box_m
    return float(((places < low) | (places > high)).any(axis=1).mean()) if len(places) else 0.0


def lattice_of(grid: Grid, nw: int | None, shape: Sequence[int] | None, spacing_m: float | None) -> Grid:
    """Another lattice over the box of one: 2^nw samples an axis, so many, or at such a spacing."""
    if sum(asked is not None for asked in (nw, shape, spacing_m)) > 1:
        raise InvalidArgument("lattice", "more than one of nw, shape and spacing", "one of them")
    low, high = grid.box_m
    if nw is not None:
        if not NW_RANGE[0] <= nw <= NW_RANGE[1]:
            raise InvalidArgument("--nw", f"{nw}", f"{NW_RANGE[0]} to {NW_RANGE[1]}")
        return Grid.over_box(low, high, (1 << nw,) * 3)
    if shape is not None:
        return Grid.over_box(low, high, tuple(shape))  # type: ignore[arg-type]
    if spacing_m is not None:
        if not 0 < spacing_m < math.inf:
            raise InvalidArgument("--spacing", repr(spacing_m), "a length of more than 0")
        x, y, z = np.maximum(1, np.rint((high - low) / spacing_m)).astype(int).tolist()
        return Grid.over_box(low, high, (x, y, z))
    return grid
