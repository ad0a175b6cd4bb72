"""Converts a medium to the frame rate, the lattice and the axes of another one, so that the two can be
compared or joined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.errors import InvalidArgument, require_between, require_one_of, require_positive
from touchfield.filters.device_spec import NW_RANGE
from touchfield.filters.region import RigidMotion
from touchfield.filters.registry import add_note
from touchfield.filters.resample import LOW_PASSES, interpolate, resample
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.pipeline.source import is_stream, open_scene
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.point_device import axes_matrix
from touchfield.sources.options import SourceOptions

KERNELS: Final = (*LOW_PASSES, "trilinear")


def read_medium(path: str | Path, spec: EncodeSpec | None = None) -> Prepared:
    """Prepare a ``.touch`` file, or a stored field on its own lattice.

    Raises SourceError if it cannot be read; InvalidArgument for a scene or a sample.
    """
    if is_stream(path):
        return prepare(path, spec)
    stored = open_scene(path, SourceOptions(kind="field")).stored
    if stored is None:
        raise InvalidArgument(str(path), "a scene", "a stored field", "Make it a medium: touchfield encode.")
    return prepare(stored, spec)


def change_rate(medium: HapticMedium, rate_hz: float) -> HapticMedium:
    """Return the medium at another rate, interpolated linearly between frames.

    The duration changes by at most half a frame.
    """
    if medium.rate_hz == rate_hz:
        return medium
    require_positive(rate_hz=rate_hz)
    cached = replace(medium, make_frame=lru_cache(2)(medium.__getitem__))  # several output frames use a frame
    count = max(1, round(len(medium) * rate_hz / medium.rate_hz))
    provenance = add_note(medium.provenance, "resampled", f"{medium.rate_hz:g} Hz to {rate_hz:g} Hz")
    timed = replace(
        medium, rate_hz=rate_hz, frame_count=count, vibration=None, segments=None, provenance=provenance
    )
    return replace(timed, make_frame=lambda i: cached.at(i / rate_hz))


def change_lattice(medium: HapticMedium, grid: Grid, kernel: str = "spline") -> HapticMedium:
    """Return the medium on another lattice.

    It is resampled through a low-pass or by trilinear interpolation.
    """
    require_one_of("kernel", kernel, KERNELS)
    if grid == medium.grid:
        return medium

    def make(i: int) -> ForceField:
        return interpolate(medium[i], grid) if kernel == "trilinear" else resample(medium[i], grid, kernel)

    provenance = add_note(
        medium.provenance, "resampled", f"{medium.grid.description} to {grid.description}, {kernel}"
    )
    return replace(medium, grid=grid, make_frame=make, vibration=None, segments=None, provenance=provenance)


def match_medium(
    medium: HapticMedium, like: HapticMedium, kernel: str = "spline", name: str = "the medium"
) -> tuple[HapticMedium, tuple[str, ...]]:
    """Bring a medium to the axes, lattice and rate of another one.

    Returns the result and notes on the changes.
    """
    notes: list[str] = []
    result = medium
    permutation = axes_matrix(medium.axes, like.axes)
    if (permutation != np.eye(3)).any():
        motion, before = RigidMotion(tuple(map(tuple, permutation.tolist()))), result  # type: ignore[arg-type]
        box = np.sort(motion.points_m(np.stack(medium.grid.box_m)), axis=0)
        shape = tuple(np.abs(permutation @ np.array(medium.grid.shape)).astype(int).tolist())
        grid = Grid.over_box(box[0], box[1], shape)
        result = replace(
            result, grid=grid, axes=like.axes, make_frame=lambda i: interpolate(before[i], grid, motion),
            vibration=None, segments=None,
        )  # fmt: skip
        notes.append(f"{name}: turned from {medium.axes} to {like.axes}")
    if result.grid != like.grid:
        notes.append(f"{name}: {result.grid.description} resampled to {like.grid.description}")
        positions_m, (low, high) = result.grid.to_m(result[len(result) // 2].positions()), like.grid.box_m
        is_outside = ((positions_m < low) | (positions_m > high)).any(axis=1)
        if is_outside.any():
            notes.append(
                f"{name}: {100 * is_outside.mean():.3g} % of its samples lie outside, and are left out"
            )
        result = change_lattice(result, like.grid, kernel)
    if result.rate_hz != like.rate_hz:
        notes.append(f"{name}: {result.rate_hz:g} Hz to {like.rate_hz:g} Hz")
        result = change_rate(result, like.rate_hz)
    return replace(result, axes=like.axes), tuple(notes)


def lattice_of(grid: Grid, nw: int | None, shape: Sequence[int] | None, spacing_m: float | None) -> Grid:
    """Return a lattice over the box of `grid`.

    It has 2^nw samples per axis, a given shape, or a given spacing.
    """
    if sum(option is not None for option in (nw, shape, spacing_m)) > 1:
        raise InvalidArgument("lattice", "more than one of nw, shape and spacing", "one of them")
    low, high = grid.box_m
    if nw is not None:
        require_between(*NW_RANGE, nw=nw)
        return Grid.over_box(low, high, (1 << nw,) * 3)
    if shape is not None:
        return Grid.over_box(low, high, tuple(shape))  # type: ignore[arg-type]
    if spacing_m is not None:
        require_positive(**{"--spacing": spacing_m})
        x, y, z = np.maximum(1, np.rint((high - low) / spacing_m)).astype(int).tolist()
        return Grid.over_box(low, high, (x, y, z))
    return grid
