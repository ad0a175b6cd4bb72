"""W_t: a haptic medium, a lazy sequence of force fields with what travels beside it (paper section 4).

"The static W representation becomes a timeseries W_t." Frames are made when they are asked for, and not
kept: a medium of a thousand frames costs no more memory than the caller holds on to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from touchfield.errors import InvalidArgument
from touchfield.medium.field import ForceField
from touchfield.medium.grid import Grid
from touchfield.medium.segments import Segments
from touchfield.medium.vibration import VibrationBand

__all__ = ["HapticMedium"]


@dataclass(frozen=True)
class HapticMedium:
    """A force field over time.

    Parameters
    ----------
    grid : Grid; The lattice of every frame.
    rate_hz : float; Frames a second.
    make_frame : callable; ``make_frame(i) -> ForceField`` on `grid`, for 0 <= i < frame_count; the same i gives the
        same field.
    axes : str; What x, y, z mean, for example "x right, y down, z forward".
    friction : float; Friction coefficient mu, rendered by the receiver (paper section 3.2).
    damping_n_s_per_m : float; Damping coefficient b, rendered by the receiver (paper section 3.2).
    tags : tuple of str; Media tags of figure 1: "direct" or "symbolic".
    provenance : mapping of str to str; Where the medium comes from and what was done to it.
    vibration : VibrationBand or None; What vibrates beside the force, frame by frame on the same grid (paper section
        6.4).
    segments : Segments or None; Of a decoded medium whose coder keeps a mask; a receiver that plays it makes no step
        where one starts.
    """

    grid: Grid
    rate_hz: float
    frame_count: int
    make_frame: Callable[[int], ForceField] = field(repr=False)
    axes: str = "x, y, z"
    friction: float = 0.0
    damping_n_s_per_m: float = 0.0
    tags: tuple[str, ...] = ("direct",)
    provenance: Mapping[str, str] = field(default_factory=dict)
    vibration: VibrationBand | None = None
    segments: Segments | None = None

    def __post_init__(self) -> None:
        if not self.rate_hz > 0:
            raise InvalidArgument("rate_hz", repr(self.rate_hz), "a positive number of frames a second")
        if self.frame_count < 1:
            raise InvalidArgument("frame_count", repr(self.frame_count), "at least one frame")
        band = self.vibration
        if band is not None and (band.grid != self.grid or band.frame_count != self.frame_count):
            found = f"{band.frame_count} frames on a grid of {band.grid.shape}"
            raise InvalidArgument("vibration", found, f"{self.frame_count} frames on the medium's grid")
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @classmethod
    def from_frames(cls, frames: Sequence[ForceField], rate_hz: float, axes: str = "x, y, z") -> HapticMedium:
        """A medium of fields that are already there."""
        kept = tuple(frames)
        if not kept:
            raise InvalidArgument("frames", "none", "at least one ForceField")
        if any(f.grid != kept[0].grid for f in kept):
            raise InvalidArgument("frames", "fields on different grids", "one grid for all")
        return cls(kept[0].grid, rate_hz, len(kept), kept.__getitem__, axes)

    def __len__(self) -> int:
        return self.frame_count

    def __getitem__(self, index: int) -> ForceField:
        if not -self.frame_count <= index < self.frame_count:
            raise IndexError(index)
        made = self.make_frame(index % self.frame_count)
        if made.grid != self.grid:
            raise InvalidArgument("make_frame", "a field on another grid", "the medium's grid")
        return made

    def __iter__(self) -> Iterator[ForceField]:
        return (self[i] for i in range(self.frame_count))

    def between(self, start: int, stop: int) -> HapticMedium:
        """Frames start to stop - 1 as a medium of their own."""
        if not 0 <= start < stop <= self.frame_count:
            raise InvalidArgument(
                "frames", f"{start}:{stop}", f"a range within 0:{self.frame_count}", "Name frames that are there."
            )
        make, band, segments = self.make_frame, self.vibration, self.segments
        return replace(
            self,
            frame_count=stop - start,
            make_frame=lambda i: make(start + i),
            vibration=None if band is None else band.between(start, stop),
            segments=None if segments is None else segments.between(start, stop),
        )
