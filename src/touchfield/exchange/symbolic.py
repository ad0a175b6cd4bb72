"""`ArrayEffect`: the drive of each actuator of an array over time, and its frequency. Every format of effects
is read into it and written from it; this file also converts it to a medium and back.

An effect is a symbolic medium (paper figure 1): it represents something and was not measured. All formats are
read into and written from `ArrayEffect`, the intermediate form between files and media.

An actuator has one drive. As in `touchfield.pipeline.array_medium`, it is the greater of |F| and the
amplitude of the vibration, divided by the force that drives an actuator fully. A medium made from an effect
therefore contains the drive twice: as the force along the array's normal, for programs that use only forces,
and as the vibration's amplitude, with the frequency. A format that stores the two apart (HJIF) restores them
apart (`ArrayEffect.parts`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Float32s, Float64s
from touchfield.devices import Device, device, device_names
from touchfield.errors import InvalidArgument, require_between, require_positive
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.field import frozen
from touchfield.medium.medium import MAX_FREQUENCY_HZ, VibrationFrame
from touchfield.sources.scene import UP_Y_AXES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from touchfield.medium import Grid


DEFAULT_RATE_HZ: Final = 100.0
"""Frames a second at which an effect is sampled: two in the shortest transients."""

DEFAULT_CARRIER_HZ: Final = 150.0
"""Frequency if none is given: within the best range of skin, and of small motors."""

MAX_RATE_HZ: Final = 10000.0

MAX_SECONDS: Final = 3600.0
"""Longest effect that is read."""

MAX_VALUES: Final = 1 << 24
"""Limit of drives read from a file, actuators times frames.

They take 64 MiB, and the frequencies as much.
"""

MAX_MEDIUM_VALUES: Final = 1 << 26
"""Limit of drives made from a medium: 256 MiB."""

TRANSIENT_S: Final = 0.022
"""Duration of a transient, s, as in ISO/IEC 23090-31's public reference decoder."""

_PITCH_MM: Final = 20.0
_FORCE_MAX_N: Final = 3.3
_OURS: Final = "our choice: an effect file states neither sizes nor forces"


@dataclass(frozen=True)
class ArrayEffect:
    """The drives of an array over time.

    Raises InvalidArgument if shapes or types are wrong, or a number is out of range.

    Parameters
    ----------
    rate_hz : float
        Frames a second; between frames a drive is linear in time.
    drives : float32 [frames, rows, columns]
        0 to 1; row 0 is the top one, column 0 the left one, as one looks at the array.
    frequencies_hz : float32 [frames, rows, columns] or None
        0 where unknown; None if all are unknown.
    parts : two float32 [frames, rows, columns] or None
        The force and the amplitude of the vibration, of which a drive is the greater, 0 to 1; None if a drive
        stands for both.
    """

    rate_hz: float
    drives: Float32s
    frequencies_hz: Float32s | None = None
    parts: tuple[Float32s, Float32s] | None = None

    def __post_init__(self) -> None:
        drives, frequencies = self.drives, self.frequencies_hz
        require_positive(rate_hz=self.rate_hz)
        if drives.dtype != np.float32 or drives.ndim != 3 or not drives.size:
            raise InvalidArgument(
                "drives", f"{drives.dtype} {drives.shape}", "float32 [frames, rows, columns]"
            )
        if not ((drives >= 0).all() and (drives <= 1).all()):
            raise InvalidArgument("drives", "a number below 0, above 1 or not finite", "0 to 1")
        object.__setattr__(self, "drives", frozen(np.ascontiguousarray(drives)))
        if self.parts is not None:
            self._check_parts(*self.parts)
        if frequencies is None:
            return
        if frequencies.dtype != np.float32 or frequencies.shape != drives.shape:
            raise InvalidArgument(
                "frequencies_hz", f"{frequencies.dtype} {frequencies.shape}", f"{drives.shape}"
            )
        if not ((frequencies >= 0).all() and (frequencies <= MAX_FREQUENCY_HZ).all()):
            raise InvalidArgument("frequencies_hz", "a number out of range", f"0 to {MAX_FREQUENCY_HZ:g} Hz")
        object.__setattr__(self, "frequencies_hz", frozen(np.ascontiguousarray(frequencies)))

    def _check_parts(self, forces: Float32s, vibrations: Float32s) -> None:
        for part in (forces, vibrations):
            if part.dtype != np.float32 or part.shape != self.drives.shape:
                raise InvalidArgument("parts", f"{part.dtype} {part.shape}", f"{self.drives.shape}")
        if (
            not (np.maximum(forces, vibrations) == self.drives).all()
            or min(forces.min(), vibrations.min()) < 0
        ):
            raise InvalidArgument(
                "parts", "parts that do not make the drives", "drives that are the greater part"
            )

    @classmethod
    def from_parts(
        cls, rate_hz: float, forces: Float32s, vibrations: Float32s, frequencies_hz: Float32s | None
    ) -> ArrayEffect:
        """Return the effect of forces and of amplitudes of vibration, 0 to 1.

        Both are float32 [frames, rows, columns]. Raises InvalidArgument as the class does.
        """
        drives = np.maximum(forces, vibrations)
        return cls(rate_hz, drives, frequencies_hz, (forces, vibrations))

    def __len__(self) -> int:
        return len(self.drives)

    @property
    def lattice(self) -> tuple[int, int, int]:
        """Columns, rows, 1."""
        _, rows, columns = self.drives.shape
        return (columns, rows, 1)


@dataclass(frozen=True)
class ImportedEffect:
    """An effect read from a file.

    `device_name` is the device that the file names ("" for none), `force_max_n` the force of a full drive if
    the file states it, and `notes` tell the user what was left out or interpreted.
    """

    effect: ArrayEffect
    device_name: str = ""
    force_max_n: float | None = None
    notes: tuple[str, ...] = ()


@dataclass
class Drive:
    """Amplitudes and frequencies (0: unknown) over the frames, float64 [frames] each.

    `strongest` is the amplitude of the drive that has set the frequency.
    """

    amplitudes: Float64s
    frequencies_hz: Float64s
    strongest: Float64s = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.strongest = self.amplitudes.copy()

    @classmethod
    def silent(cls, frames: int) -> Drive:
        """Return a drive of zero."""
        return cls(np.zeros(frames), np.zeros(frames))

    def add(self, other: Drive, frames: slice = slice(None)) -> None:
        """Add amplitudes in these frames; the frequency is that of the strongest drive that was added."""
        stronger = other.amplitudes > self.strongest[frames]
        self.frequencies_hz[frames][stronger] = other.frequencies_hz[stronger]
        self.strongest[frames][stronger] = other.amplitudes[stronger]
        self.amplitudes[frames] += other.amplitudes


def filled_hz(drives: Float32s, frequencies_hz: Float32s | None) -> Float32s:
    """Return a frequency for each drive, float32 [frames, ...] like the drives.

    An unknown frequency is replaced by the latest known one of the actuator, before the first known one by
    that one, and by `DEFAULT_CARRIER_HZ` if none is known. The frequency of a drive of zero counts as
    unknown.
    """
    if frequencies_hz is None:
        return np.full(drives.shape, DEFAULT_CARRIER_HZ, np.float32)
    has_frequency = (frequencies_hz > 0) & (drives > 0)
    order = np.arange(len(drives)).reshape(-1, *(1,) * (drives.ndim - 1))
    last = np.maximum.accumulate(np.where(has_frequency, order, -1), axis=0)
    hertz = np.take_along_axis(
        frequencies_hz, np.where(last >= 0, last, has_frequency.argmax(axis=0)), axis=0
    )
    return np.where(has_frequency.any(axis=0), hertz, np.float32(DEFAULT_CARRIER_HZ))


def check_rate(rate_hz: float) -> None:
    """Raise InvalidArgument unless an effect can be sampled at this rate."""
    require_between(1, MAX_RATE_HZ, rate_hz=rate_hz)


def checked_frames(where: str, frames: int, actuators: int, max_values: int = MAX_VALUES) -> int:
    """Return `frames`; raise InvalidArgument if they would take too much memory."""
    if frames * actuators > max_values:
        found = f"{frames} frames of {actuators} actuators"
        raise InvalidArgument(
            where, found, f"at most {max_values} drives", "Take fewer frames, or a lower rate."
        )
    return frames


def effect_device(lattice: tuple[int, int, int], name: str = "", force_max_n: float | None = None) -> Device:
    """Return the profile `name` if it matches an effect, else a generic one.

    `lattice` is columns, rows, 1; `force_max_n` is the force of a full drive, by default the profile's or 3.3
    N.
    """
    if name in device_names():
        profile = device(name)
        if profile.is_array and profile.lattice == lattice and force_max_n in (None, profile.force_max_n):
            return profile
    columns, rows, _ = lattice
    return Device(
        name=f"array-{columns}x{rows}",
        title=f"an array of {columns} x {rows} actuators",
        type=2,
        axes="columns along x right, rows along y up, normal along z",
        workspace_mm=(columns * _PITCH_MM, rows * _PITCH_MM, max(columns, rows) * _PITCH_MM),
        lattice=lattice,
        force_max_n=_FORCE_MAX_N if force_max_n is None else force_max_n,
        pitch_mm=_PITCH_MM,
        sources={"pitch_mm": _OURS, "force_max_n": _OURS},
    )


def effect_medium(
    effect: ArrayEffect, grid: Grid, force_max_n: float, provenance: Mapping[str, str]
) -> HapticMedium:
    """Convert an effect to a symbolic medium on (columns, rows, 1) samples.

    x is right and y up. The force along z is the drive times `force_max_n`, which drives an actuator fully;
    so is the amplitude of the vibration. Of an effect with parts each has its own.
    """
    if grid.shape != effect.lattice:
        raise InvalidArgument("grid", f"{grid.shape}", f"{effect.lattice}, as the effect has it")
    scale = np.float32(force_max_n)
    force_part, vibration_part = effect.parts or (effect.drives, effect.drives)

    def make_field(i: int) -> ForceField:
        forces = np.zeros((*grid.shape, 3), np.float32)
        forces[:, :, 0, 2] = force_part[i][::-1].T * scale
        return ForceField.from_dense(grid, forces)

    def vibration(i: int) -> VibrationFrame:
        assert effect.frequencies_hz is not None
        hertz, amplitudes_n = effect.frequencies_hz[i][::-1].T, vibration_part[i][::-1].T * scale
        driven = np.argwhere((hertz > 0) & (amplitudes_n > 0))
        x, y = driven.T
        positions = np.concatenate([driven, np.zeros((len(driven), 1), np.int64)], axis=1).astype(np.int32)
        return VibrationFrame(grid, positions, amplitudes_n[x, y], hertz[x, y])

    return HapticMedium(
        grid, effect.rate_hz, len(effect), make_field, axes=UP_Y_AXES, tags=("symbolic",),
        provenance=provenance, vibration=None if effect.frequencies_hz is None else vibration,
    )  # fmt: skip
