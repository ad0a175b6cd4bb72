"""HJIF (ISO/IEC 23090-31) as drives of an array, and as a force over time.

An array is made of the channels of the first perception that is felt (`MODALITIES`). A channel drives the actuators
that it targets; one without targets drives all of its array, and where no channel tells of an array, the channels lie
in a row. Body parts lie side by side, in the order in which they come. Where several channels meet, amplitudes add
up, to 1 at most, and the frequency is that of the strongest.

Drives are sampled at the frames of a rate; between frames they are linear, so that what moves faster is smoothed.
A force is read at its own keyframes, and nothing is lost.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.adapters.band_sampling import curve_at, drive_of, end_tick
from touchfield.adapters.hjif_read import Channel, Hjif, Perception, hjif_of, read_hjif
from touchfield.adapters.symbolic import (
    DEFAULT_RATE_HZ,
    MAX_SECONDS,
    MAX_VALUES,
    ArrayEffect,
    ImportedEffect,
    checked_frames,
    checked_rate,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]
    Cells = NDArray[np.int64]

__all__ = ["MODALITIES", "read_hjif_array", "read_hjif_force"]

MODALITIES: Final = ("Vibrotactile", "Vibrotactile Texture", "Pressure", "Force", "Other")
"""What can be shown by an array of actuators. What is "Other" is shown as a vibration: the reference encoder calls
every sound and pattern that it is given so."""

_MOST_WORK: Final = 1 << 28


def read_hjif_array(path: str | Path, rate_hz: float = DEFAULT_RATE_HZ) -> ImportedEffect:
    """An ``.hjif`` or ``.hmpg`` file as the drives of an array, so many frames a second.

    A force of several directions becomes the drive of one actuator, its magnitude. Raises SourceError as `read_hjif`,
    and if nothing in it can be felt, or it is longer than an hour; InvalidArgument if the rate is out of range, or
    there would be too many drives.
    """
    checked_rate(rate_hz)
    document = _read(path)
    felt = [one for one in document.perceptions if one.modality in MODALITIES[:-1]]
    felt = felt or [one for one in document.perceptions if one.modality in MODALITIES]
    if not felt:
        raise document.place.wrong(
            "perceptions of " + ", ".join(sorted({one.modality for one in document.perceptions})),
            "one of " + ", ".join(MODALITIES),
        )
    perception = felt[0]
    notes = _notes(document, perception)
    frames = _frames(document, perception, rate_hz)
    if perception.modality == "Force" and any(one.direction for one in perception.channels):
        return _magnitude(document, perception, frames, rate_hz, notes)
    cells, rows, columns, parts = _cells(perception, frames)
    if parts > 1:
        notes += (f"Its {parts} body parts lie side by side.",)
    total, strongest, hertz = (np.zeros((rows * columns, frames), np.float32) for _ in range(3))
    for channel, own in zip(perception.channels, cells):
        drive = drive_of(channel.bands, frames, document.timescale / rate_hz, document.timescale)
        amplitudes = np.minimum(drive.amplitudes * channel.gain, 1).astype(np.float32)
        stronger = amplitudes > strongest[own]
        hertz[own] = np.where(stronger, drive.frequencies_hz.astype(np.float32), hertz[own])
        strongest[own] = np.maximum(strongest[own], amplitudes)
        total[own] = np.minimum(total[own] + amplitudes, 1)
    unknown = (strongest > 0) & (hertz == 0)
    if unknown.any():
        share = 100 * float(unknown.sum() / (strongest > 0).sum())
        notes += (f"{share:.3g} % of what is felt has no frequency of its own, and is played at a device's own.",)
    drives, frequencies = (_images(of, rows, columns) for of in (total, hertz))
    effect = ArrayEffect(float(rate_hz), drives, frequencies if frequencies.any() else None)
    return ImportedEffect(effect, perception.device_name, notes=notes)


def read_hjif_force(path: str | Path) -> tuple[Float64s, Float64s]:
    """The force that a file holds, at its keyframes: ascending seconds [n], and newtons along x, y, z [n, 3].

    It is linear in between. Raises SourceError as `read_hjif`, and if there is no perception of force, a channel has
    no direction, or a band is no Curve.
    """
    document = _read(path)
    perceptions = [one for one in document.perceptions if one.modality == "Force"]
    if not perceptions:
        raise document.place.wrong("no perception of force", "one of modality Force")
    ticks = _keyframe_ticks(perceptions[0])
    return ticks / document.timescale, _force_n(perceptions[0], ticks)


def _read(path: str | Path) -> Hjif:
    if Path(path).suffix.lower() == ".hmpg":
        from touchfield.adapters.hmpg_read import read_hmpg

        return hjif_of(read_hmpg(path))
    return read_hjif(path)


def _keyframe_ticks(perception: Perception) -> Float64s:
    """Every tick at which a line begins or ends; where an effect ends there is one more, at which it is over."""
    ends = [np.zeros(1, np.int64)]
    for channel in perception.channels:
        for band in channel.bands:
            held = [effect for effect in band.effects if len(effect.ticks)]
            ends += [effect.position + effect.ticks for effect in held]
            ends += [one.position + one.ticks[-1:] + 1 for one in held[:-1]]
    ticks = np.unique(np.concatenate(ends)).astype(np.float64)
    _check_work(perception, len(ticks))
    return ticks


def _force_n(perception: Perception, ticks: Float64s) -> Float64s:
    """The sum of all channels along their directions, float64 [n, 3]."""
    forces, unit_n = np.zeros((len(ticks), 3)), 10.0**perception.unit_exponent
    for channel in perception.channels:
        if channel.direction is None or not any(channel.direction):
            raise channel.place.wrong("a force without a direction", "a direction of length 127")
        along = np.array(channel.direction, np.float64)
        along *= channel.gain * unit_n / np.linalg.norm(along)
        for band in channel.bands:
            if band.kind != "Curve":
                raise band.place.wrong(f"a band of type {band.kind}", "a Curve")
            forces += curve_at(band, ticks)[:, None] * along
    if not np.isfinite(forces).all():
        raise perception.place.wrong("forces that are not finite", "finite newtons")
    return forces


def _magnitude(
    document: Hjif, perception: Perception, frames: int, rate_hz: float, notes: tuple[str, ...]
) -> ImportedEffect:
    """A force as the drive of one actuator."""
    ticks = np.arange(frames, dtype=np.float64) * (document.timescale / rate_hz)
    magnitude_n = np.linalg.norm(_force_n(perception, ticks), axis=1)
    greatest_n = float(np.linalg.norm(_force_n(perception, _keyframe_ticks(perception)), axis=1).max())
    if not 0 < greatest_n <= 1e6:
        raise perception.place.wrong(f"a greatest force of {greatest_n:g} N", "newtons above 0, up to a million")
    drives = np.minimum(magnitude_n / greatest_n, 1).astype(np.float32).reshape(-1, 1, 1)
    notes += ("Of the force its magnitude is taken, as the drive of one actuator.",)
    return ImportedEffect(ArrayEffect(float(rate_hz), drives), perception.device_name, greatest_n, notes)


def _notes(document: Hjif, perception: Perception) -> tuple[str, ...]:
    left = [one.modality for one in document.perceptions if one is not perception]
    notes = (f"Left out: {len(left)} other perceptions ({', '.join(sorted(set(left)))}).",) if left else ()
    if perception.modality == "Other":
        notes = (*notes, 'Its perception is told as "Other", of no unit: it is read as a vibration.')
    return notes


def _frames(document: Hjif, perception: Perception, rate_hz: float) -> int:
    bands = [band for channel in perception.channels for band in channel.bands]
    seconds: float = max((end_tick(band, document.timescale) for band in bands), default=0) / document.timescale
    if seconds > MAX_SECONDS:
        raise perception.place.wrong(f"an effect of {seconds:g} s", f"at most {MAX_SECONDS:g} s")
    frames = math.floor((seconds + 0.5 / document.timescale) * rate_hz + 1e-6) + 1  # the last may be half a tick late
    _check_work(perception, frames)
    return checked_frames(document.place.file, frames, 1)


def _check_work(perception: Perception, instants: int) -> None:
    """That the bands are not so many that to look at each instant of each would take for ever."""
    bands = sum(len(channel.bands) + 1 for channel in perception.channels)
    if bands * instants > _MOST_WORK:
        raise perception.place.wrong(f"{bands} bands at {instants} instants", f"at most {_MOST_WORK} of both")


def _cells(perception: Perception, frames: int) -> tuple[list[Cells], int, int, int]:
    """For each channel the actuators that it drives, counted row by row from the lower left; rows, columns, parts."""
    channels = perception.channels
    parts: dict[tuple[str, ...], list[int]] = {}
    for n, channel in enumerate(channels):
        parts.setdefault(channel.body, []).append(n)
    sizes, rows, columns, offsets = {}, 1, 0, {}
    for body, members in parts.items():
        sizes[body] = _extent([channels[n] for n in members])
        offsets[body] = columns
        columns, rows = columns + sizes[body][0], max(rows, sizes[body][1])
    untargeted = [(channels[n], sizes[body]) for body in parts for n in parts[body] if not channels[n].targets]
    reached = sum(len(one.targets or ()) for one in channels)
    reached += sum(math.prod(one.resolution or size) for one, size in untargeted)
    if max(reached, rows * columns) * frames > MAX_VALUES:
        found = f"{frames} frames of {max(reached, rows * columns)} actuators"
        raise perception.place.wrong(found, f"at most {MAX_VALUES} drives", "Take a lower rate.")
    cells: list[Cells] = [np.zeros(0, np.int64)] * len(channels)
    for body, members in parts.items():
        in_a_row = not any(channels[n].resolution or channels[n].targets for n in members)
        for place, n in enumerate(members):
            at = np.array([(place, 0)]) if in_a_row else _targets(channels[n], sizes[body])
            cells[n] = at[:, 1] * columns + at[:, 0] + offsets[body]
    return cells, rows, columns, len(parts)


def _extent(channels: list[Channel]) -> tuple[int, int]:
    """Columns and rows of one body part."""
    told = [one.resolution for one in channels if one.resolution]
    told += [(x + 1, y + 1) for one in channels for x, y in one.targets or ()]
    if not told:
        return (len(channels), 1)
    return (max(x for x, _ in told), max(y for _, y in told))


def _targets(channel: Channel, size: tuple[int, int]) -> NDArray[np.int64]:
    if channel.targets:
        return np.array(sorted(set(channel.targets)), np.int64)
    columns, rows = channel.resolution or size
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)


def _images(of: NDArray[np.float32], rows: int, columns: int) -> NDArray[np.float32]:
    """[actuators from the lower left, frames] as [frames, rows from the top, columns]."""
    return np.ascontiguousarray(of.reshape(rows, columns, -1).transpose(2, 0, 1)[:, ::-1])
