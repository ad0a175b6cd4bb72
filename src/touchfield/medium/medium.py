"""`HapticMedium`: a sequence of force fields with a frame rate and other metadata, each computed when it is
requested. `HapticScene`: bodies that each have a field and poses (paper section 4).

In the paper's words, "the static W representation becomes a timeseries W_t". Frames are computed on access
and not cached: a medium of a thousand frames takes no more memory than the frames that the caller keeps.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float32s, Float64s, Int32s, Picklable
from touchfield.errors import InvalidArgument, import_extra, is_finite, require_not_negative, require_positive
from touchfield.hooks import hook
from touchfield.medium.budget import require_memory
from touchfield.medium.field import ForceField, frozen, numbers_of
from touchfield.medium.grid import Grid
from touchfield.medium.pose_track import PoseTrack

if TYPE_CHECKING:
    from touchfield.medium.cells import PlacedFields

_AT_A_FRAME = 1e-6  # fraction of a frame period within which a time counts as that of the frame
MAX_FREQUENCY_HZ: Final = 10000.0  # as in ISO/IEC 23090-31


@dataclass(frozen=True)
class VibrationFrame:
    """One instant of a vibration: amplitude and frequency of the samples that vibrate.

    positions : int32 [L, 3]; indices into the grid, distinct, in raster order (x slowest, z fastest).
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
            keys = (p[:, 0].astype(np.int64) * ny + p[:, 1]) * nz + p[:, 2]
            if (np.diff(keys) <= 0).any():
                raise InvalidArgument("positions", "samples out of order or twice", "raster order")
            if f.max() > MAX_FREQUENCY_HZ:
                raise InvalidArgument("frequencies_hz", f"{f.max():g} Hz", f"up to {MAX_FREQUENCY_HZ:g} Hz")
        for name in ("positions", "amplitudes_n", "frequencies_hz"):
            object.__setattr__(self, name, frozen(np.ascontiguousarray(getattr(self, name))))

    @classmethod
    def empty(cls, grid: Grid) -> VibrationFrame:
        """Return the frame in which nothing vibrates."""
        none = np.zeros(0, np.float32)
        return cls(grid, np.zeros((0, 3), np.int32), none, none)

    def __len__(self) -> int:
        return len(self.positions)

    def as_field(self) -> ForceField:
        """Return a sparse field whose components are amplitude, frequency and zero.

        It serves to look up the vibration at samples.
        """
        both = np.stack([self.amplitudes_n, self.frequencies_hz, np.zeros_like(self.amplitudes_n)], axis=1)
        return ForceField.from_support(self.grid, self.positions, both)


def _later(make: Callable[[int], Any], start: int, index: int) -> Any:
    return make(start + index)


@dataclass(frozen=True)
class Segments:
    """Segments: runs of frames that are coded independently of earlier frames.

    Raises `InvalidArgument` if there is no start, the first is not 0, or they do not ascend.
    """

    starts: tuple[int, ...]  # first frame of each segment, ascending from 0
    k: float  # every force F of the source is decoded with an error of at most max(F_0, k |F|)
    f0_n: float

    def __post_init__(self) -> None:
        if self.starts[:1] != (0,) or any(a >= b for a, b in zip(self.starts, self.starts[1:])):
            raise InvalidArgument("starts", f"{self.starts[:4]}", "frames in ascending order, 0 the first")

    def segment_at(self, frame: int, frame_count: int) -> tuple[int, int]:
        """Return the first frame and the number of frames of the segment of a frame."""
        index = bisect_right(self.starts, frame)
        stop = self.starts[index] if index < len(self.starts) else frame_count
        return self.starts[index - 1], stop - self.starts[index - 1]

    def between(self, start: int, stop: int) -> Segments:
        """Return the segments of frames start to stop - 1, renumbered from 0."""
        within = tuple(at - start for at in self.starts if start < at < stop)
        return replace(self, starts=(0, *within))


@dataclass(frozen=True)
class HapticMedium(Picklable):
    """A force field over time.

    grid : Grid; the lattice of every frame.
    rate_hz : float; frames a second.
    make_frame : callable; ``make_frame(i) -> ForceField`` on `grid`, 0 <= i < frame_count; it returns equal
        fields for equal i.
    axes : str; directions of x, y, z, for example "x right, y down, z forward".
    friction, damping_n_s_per_m : float; coefficients mu and b, rendered by the receiver (paper section 3.2).
    tags : tuple of str; media tags of figure 1: "direct" or "symbolic".
    provenance : mapping of str to str; source of the medium and the processing steps applied to it.
    vibration : callable or None; ``vibration(i) -> VibrationFrame`` on `grid`: the vibration that accompanies
        the forces of frame i (paper section 6.4).
    segments : Segments or None; segments of a medium whose coder guarantees an error bound; a receiver
        renders no step at the start of a segment.
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
    vibration: Callable[[int], VibrationFrame] | None = field(default=None, repr=False)
    segments: Segments | None = None

    def __post_init__(self) -> None:
        require_positive(rate_hz=self.rate_hz)
        if self.frame_count < 1:
            raise InvalidArgument("frame_count", repr(self.frame_count), "at least one frame")
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @classmethod
    def from_frames(cls, frames: Sequence[ForceField], rate_hz: float, axes: str = "x, y, z") -> HapticMedium:
        """Make a medium of existing fields."""
        fields = tuple(frames)
        if not fields or not all(isinstance(frame, ForceField) for frame in fields):
            raise InvalidArgument(
                "frames", "none, or what is no field", "ForceFields", "`from_array` takes newtons."
            )
        if any(f.grid != fields[0].grid for f in fields):
            raise InvalidArgument("frames", "fields on different grids", "one grid for all")
        return cls(fields[0].grid, rate_hz, len(fields), fields.__getitem__, axes)

    @classmethod
    def from_array(
        cls, forces_n: ArrayLike, grid: Grid, rate_hz: float = 30.0, axes: str = "x, y, z"
    ) -> HapticMedium:
        """Make a medium of a dense array, newtons [frame, nx, ny, nz, 3].

        The first axis may be missing for a single frame.

        Raises `InvalidArgument` if the shape is not the grid's, or a force is not finite.
        """
        dense = forces_n if isinstance(forces_n, np.ndarray) else numbers_of("forces_n", forces_n, np.float32)
        frames = dense[None] if dense.ndim == 4 else dense
        if frames.ndim != 5 or not len(frames):
            expected = f"{('frames', *grid.shape, 3)} or {(*grid.shape, 3)}, as the grid says"
            raise InvalidArgument("forces_n", f"shape {dense.shape}", expected)
        return cls.from_frames([ForceField.from_dense(grid, frame) for frame in frames], rate_hz, axes)

    @property
    def metadata(self) -> dict[str, Any]:
        """Rate, axes, tags, friction and damping, by their names in files."""
        return {
            name: getattr(self, name) for name in ("rate_hz", "axes", "tags", "friction", "damping_n_s_per_m")
        }

    def __repr__(self) -> str:
        frames = f"{self.frame_count} frame{'s' * (self.frame_count != 1)} at {self.rate_hz:g} Hz"
        vibration = ", with vibration" * (self.vibration is not None)
        return f"<HapticMedium: {frames} on {self.grid.description}; {self.axes}{vibration}>"

    def __len__(self) -> int:
        return self.frame_count

    @overload
    def __getitem__(self, index: int) -> ForceField: ...
    @overload
    def __getitem__(self, index: slice) -> HapticMedium: ...
    def __getitem__(self, index: int | slice) -> ForceField | HapticMedium:
        try:
            selected = range(self.frame_count)[index]
        except TypeError:
            raise InvalidArgument("frames", repr(index), "a whole number or START:STOP") from None
        except IndexError:
            raise IndexError(f"frame {index} of a medium of {self.frame_count}") from None
        if isinstance(selected, range):
            if selected.step != 1:
                raise InvalidArgument(
                    "frames", f"a step of {selected.step}", "START:STOP", "`resample` changes the rate."
                )
            return self.between(selected.start, selected.stop)
        frame = self.make_frame(selected)
        if frame.grid != self.grid:
            raise InvalidArgument("make_frame", "a field on another grid", "the medium's grid")
        return frame

    def __iter__(self) -> Iterator[ForceField]:
        return (self[i] for i in range(self.frame_count))

    def between(self, start: int, stop: int) -> HapticMedium:
        """Return frames start to stop - 1 as a medium."""
        if not 0 <= start < stop <= self.frame_count:
            hint = "Name frames that are there."
            raise InvalidArgument("frames", f"{start}:{stop}", f"a range within 0:{self.frame_count}", hint)
        vibration, segments = self.vibration, self.segments
        return replace(
            self,
            frame_count=stop - start,
            make_frame=partial(_later, self.make_frame, start),
            vibration=vibration and partial(_later, vibration, start),
            segments=segments and segments.between(start, stop),
        )

    def at(self, time_s: float) -> ForceField:
        """Return the field at a time in seconds, interpolated linearly between frames.

        Before the first and after the last frame it is that frame.

        Raises `InvalidArgument` if the time is not finite.
        """
        first, second, weight = self._frames_at(time_s)
        if not weight:
            return self[first]
        return self[first].scaled(1 - weight) + self[second].scaled(weight)

    def sample_n(self, positions_m: ArrayLike, time_s: float = 0.0) -> Float32s:
        """Return the force at points [..., 3] in metres, newtons, float32 [..., 3].

        `time_s` is in seconds; see `at`. `touchfield.FieldSampler`, which caches frames, is faster for many
        times.
        """
        first, second, weight = self._frames_at(time_s)
        sampled = self[first].sample_n(positions_m)
        if not weight:
            return sampled
        return sampled * np.float32(1 - weight) + self[second].sample_n(positions_m) * np.float32(weight)

    def _frames_at(self, time_s: float) -> tuple[int, int, float]:
        """Return the frames before and after a time, and the weight of the second."""
        if not is_finite(time_s):
            raise InvalidArgument("time_s", repr(time_s), "seconds, a finite number")
        position = min(max(time_s * self.rate_hz, 0.0), self.frame_count - 1.0)
        nearest = round(position)
        if abs(position - nearest) < _AT_A_FRAME:
            return nearest, nearest, 0.0
        return math.floor(position), math.floor(position) + 1, position - math.floor(position)

    # filters and plots belong to higher packages, which register these functions (`touchfield.hooks`)

    def filtered(self, *filters: str) -> HapticMedium:
        """Apply haptic filters given as text, such as "gaussian:sigma=2mm", in order.

        Raises `InvalidArgument` if a filter is unknown or its text is invalid.
        """
        medium: HapticMedium = hook("filter_by_text")(self, filters)
        return medium

    def to_xarray(self) -> Any:
        """Convert to an `xarray.Dataset`.

        It has ``forces_n``, float32 [t, x, y, z, component], with axes in s and m.

        Raises `MissingExtra` without xarray; `InvalidArgument` if the dense frames exceed
        `memory_budget_bytes`.
        """
        xarray = import_extra("xarray", "a medium as a Dataset", "xarray", "xarray")
        needed = 12 * self.grid.voxel_count * self.frame_count
        require_memory("to_xarray", "dense frames", needed, "Take fewer frames: medium[a:b].")
        forces = np.stack([self[i].to_dense() for i in range(self.frame_count)])
        axes = self.grid.coordinates
        times = ("t", np.arange(self.frame_count) / self.rate_hz, {"units": "s"})
        return xarray.Dataset(
            {"forces_n": (("t", "x", "y", "z", "component"), forces, {"units": "N"})},
            {"t": times, **axes, "component": list("xyz")},
            {**self.metadata, "tags": list(self.tags)},
        )

    def _repr_html_(self) -> str:
        """Return the page of the first frames, for a notebook; see `touchfield.view`."""
        html: str = hook("view")(self)._repr_html_()
        return html

    def plot(self, path: str | Path | None = None) -> Any:
        """Draw the forces from the front, the side and above, with matplotlib.

        Returns the figure, and writes a PNG if `path` is given.

        Raises `MissingExtra` if matplotlib is not installed.
        """
        return hook("draw_medium")(self, path)


@dataclass(frozen=True)
class HapticObject:
    """A force field in its body frame, and the pose of that frame over time."""

    name: str
    medium: HapticMedium  # one frame for a rigid object; for a deforming one, as many as the scene
    track: PoseTrack  # scene from body, one pose for each frame of the scene

    @property
    def is_rigid(self) -> bool:
        """True if one field serves all frames."""
        return len(self.medium) == 1

    def field(self, frame: int) -> ForceField:
        """Return the object's field at a frame of the scene, in the body frame."""
        return self.medium[0 if self.is_rigid else frame]


class BodyPoses(NamedTuple):
    """The poses of all bodies of a scene in one frame.

    `quaternions` (w, x, y, z) and `positions_m` are scene from body, one for each body; `motions` are linear
    and angular velocity, each times the surface damping, N and N/m. With `is_absent` the frame did not
    arrive: no body has a force in it, and the poses are those of an earlier frame.
    """

    quaternions: Sequence[Sequence[float]]
    positions_m: Sequence[Sequence[float]]
    motions: Sequence[Sequence[float]]
    is_absent: bool = False


@dataclass(frozen=True)
class HapticScene(Picklable):
    """Haptic objects over time; the space between them is empty.

    grid : Grid; lattice of the device over the workspace, used by `voxelise`; objects may extend beyond it.
    force_max_n : float; F_max, to which the sum of overlapping objects is clipped.
    surface_damping_n_s_per_m : float; damping b of a moving surface: where an object has a force, b times the
        velocity of the body at that point is added to it. With the receiver's damping b this gives F_d = -b
        (v_hand - v_surface).
    axes, friction, damping_n_s_per_m, tags, provenance; as in `HapticMedium`.
    file_bytes : int or None; length of the file that the scene was read from, bytes; it limits the work of
        `voxelise` on the scene's own grid.
    """

    grid: Grid
    rate_hz: float
    objects: tuple[HapticObject, ...]
    force_max_n: float
    surface_damping_n_s_per_m: float = 0.0
    axes: str = "x, y, z"
    friction: float = 0.0
    damping_n_s_per_m: float = 0.0
    tags: tuple[str, ...] = ("direct",)
    provenance: Mapping[str, str] = field(default_factory=dict)
    file_bytes: int | None = None

    has_gaps: ClassVar[bool] = False
    """True if frames may be absent, as in a live stream."""

    def __post_init__(self) -> None:
        if not self.objects:
            raise InvalidArgument("objects", "none", "at least one HapticObject")
        require_positive(force_max_n=self.force_max_n, rate_hz=self.rate_hz)
        require_not_negative(surface_damping_n_s_per_m=self.surface_damping_n_s_per_m)
        count = len(self.objects[0].track)
        for scene_object in self.objects:
            where = f"object {scene_object.name}"
            if len(scene_object.track) != count:
                raise InvalidArgument(
                    where, f"{len(scene_object.track)} poses", f"{count}, as the first object has"
                )
            if not scene_object.is_rigid and len(scene_object.medium) != count:
                raise InvalidArgument(where, f"{len(scene_object.medium)} fields", f"1 or {count}")
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @cached_property
    def _placed(self) -> PlacedFields:
        from touchfield.medium.cells import PlacedFields

        return PlacedFields(self)

    @cached_property
    def _motions(self) -> list[Float64s]:
        """Velocities of each body times the surface damping, float64 [frames, 6]."""
        damping = self.surface_damping_n_s_per_m
        return [body.track.surface_motions(self.rate_hz, damping) for body in self.objects]

    def poses(self, frame: int) -> BodyPoses:
        """Return the poses of all bodies in a frame."""
        tracks = [scene_object.track for scene_object in self.objects]
        positions_m: list[Any] = [track.positions(frame) for track in tracks]
        return BodyPoses(
            [track.quaternions[frame] for track in tracks],
            positions_m,
            [motions[frame] for motions in self._motions],
        )

    @property
    def frame_count(self) -> int:
        """Frames of the scene."""
        return len(self.objects[0].track)

    def __len__(self) -> int:
        return self.frame_count

    def between(self, start: int, stop: int) -> HapticScene:
        """Return frames start to stop - 1 as a scene.

        Velocities are computed from the poses of the new scene: one-sided at its first and last frame, zero
        for a single frame.
        """

        def cut(scene_object: HapticObject) -> HapticObject:
            medium = (
                scene_object.medium if scene_object.is_rigid else scene_object.medium.between(start, stop)
            )
            return HapticObject(scene_object.name, medium, scene_object.track.between(start, stop))

        return replace(self, objects=tuple(map(cut, self.objects)))

    def sample_n(self, frame: int, positions_m: ArrayLike) -> Float32s:
        """Return the force at points of the scene, newtons, float32 [..., 3].

        `positions_m` [..., 3] is in metres. This is the query that a receiver makes. The field of each object
        is interpolated in its body frame, as `ForceField.sample_n` does.
        """
        return self._placed.sample_n(frame, positions_m)

    def voxelise(self, grid: Grid | None = None) -> HapticMedium:
        """Return the voxel representation: a lazy medium on `grid`.

        The default is the scene's own grid. Each sample equals `sample_n` at its position. For a scene from a
        file, on its own grid, a frame raises `CorruptFile` if its objects reach more bricks than the size of
        the file justifies (docs/format/objects.md).
        """
        lattice, placed = self.grid if grid is None else grid, self._placed
        file_bytes = self.file_bytes if lattice == self.grid else None
        metadata = self.axes, self.friction, self.damping_n_s_per_m, self.tags, self.provenance
        frame_count, make = self.frame_count, lambda i: placed.voxels(i, lattice, file_bytes)
        return HapticMedium(lattice, self.rate_hz, frame_count, make, *metadata)
