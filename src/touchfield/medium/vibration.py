"""Vibration beside force (start of paper section 6.4): at each sample a frequency and an amplitude.

A force field moves a hand, and what a hand feels as a force ends at some 20 to 30 Hz; a vibration above that is not
worth 1000 forces a second. It travels as what it is: a sine's frequency and its amplitude where the hand is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Int32s
from touchfield.errors import InvalidArgument
from touchfield.medium.field import ForceField, frozen
from touchfield.medium.grid import Grid

MAX_FREQUENCY_HZ: Final = 10000.0
"""As in ISO/IEC 23090-31."""


@dataclass(frozen=True)
class VibrationFrame:
    """One instant of the band: the samples that vibrate, in raster order (x slowest, z fastest).

    positions : int32 [L, 3]; indices into the grid, each once, in raster order.
    amplitudes_n : float32 [L]; amplitude of the sine, newtons, positive.
    frequencies_hz : float32 [L]; above 0, up to `MAX_FREQUENCY_HZ`.
    Raises `InvalidArgument` if shapes or types are wrong, or a number is out of range.
    """

    grid: Grid
    positions: Int32s
    amplitudes_n: Float32s
    frequencies_hz: Float32s

    def __post_init__(self) -> None:
        p, a, f = self.positions, self.amplitudes_n, self.frequencies_hz
        if p.dtype != np.int32 or p.ndim != 2 or p.shape[1] != 3:
            raise InvalidArgument("positions", f"{p.dtype} {p.shape}", "int32 [L, 3]")
        for name, values in (("amplitudes_n", a), ("frequencies_hz", f)):
            if values.dtype != np.float32 or values.shape != (len(p),):
                raise InvalidArgument(name, f"{values.dtype} {values.shape}", f"float32 [{len(p)}]")
            if not (np.isfinite(values).all() and (values > 0).all()):
                raise InvalidArgument(name, "a number that is not positive and finite", "positive numbers")
        if len(p):
            if p.min() < 0 or (p.max(0) >= self.grid.shape).any():
                raise InvalidArgument("positions", "an index outside the grid", f"below {self.grid.shape}")
            _, ny, nz = self.grid.shape
            places = (p[:, 0].astype(np.int64) * ny + p[:, 1]) * nz + p[:, 2]
            if (np.diff(places) <= 0).any():
                raise InvalidArgument("positions", "samples out of order or twice", "raster order")
            if f.max() > MAX_FREQUENCY_HZ:
                raise InvalidArgument("frequencies_hz", f"{f.max():g} Hz", f"up to {MAX_FREQUENCY_HZ:g} Hz")
        for name in ("positions", "amplitudes_n", "frequencies_hz"):
            object.__setattr__(self, name, frozen(np.ascontiguousarray(getattr(self, name))))

    @classmethod
    def empty(cls, grid: Grid) -> VibrationFrame:
        """The frame in which nothing vibrates."""
        none = np.zeros(0, np.float32)
        return cls(grid, np.zeros((0, 3), np.int32), none, none)

    def __len__(self) -> int:
        return len(self.positions)

    def as_field(self) -> ForceField:
        """The same as a sparse field whose three numbers are amplitude, frequency and zero: for looking it up."""
        both = np.stack([self.amplitudes_n, self.frequencies_hz, np.zeros_like(self.amplitudes_n)], axis=1)
        return ForceField.from_support(self.grid, self.positions, both)


@dataclass(frozen=True)
class VibrationBand:
    """The band over time: as many frames as the medium that it belongs to, on the same grid.

    make_frame : callable; ``make_frame(i) -> VibrationFrame``.
    """

    grid: Grid
    frame_count: int
    make_frame: Callable[[int], VibrationFrame] = field(repr=False)

    def __len__(self) -> int:
        return self.frame_count

    def __getitem__(self, index: int) -> VibrationFrame:
        if not -self.frame_count <= index < self.frame_count:
            raise IndexError(index)
        return self.make_frame(index % self.frame_count)

    def between(self, start: int, stop: int) -> VibrationBand:
        """Frames start to stop - 1 as a band of their own."""
        make = self.make_frame
        return VibrationBand(self.grid, stop - start, lambda i: make(start + i))

    def on_grid(self, grid: Grid) -> VibrationBand:
        """The same samples on another grid of the same shape (its metres changed, its samples not)."""
        if grid.shape != self.grid.shape:
            raise InvalidArgument("grid", f"shape {grid.shape}", f"shape {self.grid.shape}")
        make = self.make_frame
        return VibrationBand(grid, self.frame_count, lambda i: replace(make(i), grid=grid))
