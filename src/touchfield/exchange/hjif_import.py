"""HJIF (ISO/IEC 23090-31) as drives of an array, and as a force over time.

An array is made of the channels of the first perception that is felt (`MODALITIES`). A channel drives the
actuators that it targets; one without targets drives all of its array, and where no channel tells of an
array, the channels lie in a row. Body parts lie side by side, in the order in which they come. Where several
channels meet, amplitudes add up, to 1 at most, and the frequency is that of the strongest.

Drives are sampled at the frames of a rate; between frames they are linear, so that what moves faster is
smoothed.

What counts is what an actuator is driven with, not the wave that it makes of it: of a VectorialWave the
amplitude and the frequency, whatever its base signal; of a Transient a burst that falls to nothing within
`TRANSIENT_S`; of a block of wavelets envelope and frequency (`wave_drive`), and so of a Curve that is a
vibration drawn point by point, as the reference encoder draws what lies below 72 Hz. Any other Curve is its
magnitude, without a frequency. In a band the latest effect that has begun is the one that is felt, as in the
reference decoder. What is too short to meet a frame is told at the nearest one.

**Waves told as samples.** Between two crossings lies half a wave. Its greatest value is told at its place,
and lines between these places are the envelope; the half waves that pass in a window are the frequency there.
A signal of fewer than two crossings, or one slower than `SLOWEST_HZ`, is no vibration: it has a magnitude and
no frequency.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.exchange.hjif_read import Band, Effect, Hjif, Perception, read_hjif
from touchfield.exchange.symbolic import (
    DEFAULT_RATE_HZ,
    MAX_SECONDS,
    MAX_VALUES,
    TRANSIENT_S,
    ArrayEffect,
    Drive,
    ImportedEffect,
    check_rate,
    checked_frames,
)

if TYPE_CHECKING:
    from collections.abc import Iterable


MODALITIES: Final = ("Vibrotactile", "Vibrotactile Texture", "Pressure", "Force", "Other")
"""Perception modalities that actuators can show. "Other" is shown as a vibration: the reference encoder calls
every sound and pattern that it is given so."""

_MOST_WORK: Final = 1 << 28


def read_hjif_array(path: str | Path, rate_hz: float = DEFAULT_RATE_HZ) -> ImportedEffect:
    """An ``.hjif`` or ``.hmpg`` file as the drives of an array, so many frames a second.

    A force of several directions becomes the drive of one actuator, its magnitude. Raises SourceError as
    `read_hjif`, and if nothing in it can be felt, or it is longer than an hour; InvalidArgument if the rate
    is out of range, or there would be too many drives.
    """
    check_rate(rate_hz)
    document = read_hjif(path)
    felt = [one for one in document.perceptions if one.modality in MODALITIES]
    if not felt:
        raise document.place.wrong(
            "perceptions of " + ", ".join(sorted({one.modality for one in document.perceptions})),
            "one of " + ", ".join(MODALITIES),
        )
    perception = next((one for one in felt if one.modality != "Other"), felt[0])
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
        notes += (
            f"{share:.3g} % of what is felt has no frequency of its own, and is played at a device's own.",
        )
    drives, frequencies = (_images(of, rows, columns) for of in (total, hertz))
    effect = ArrayEffect(float(rate_hz), drives, frequencies if frequencies.any() else None)
    return ImportedEffect(effect, perception.device_name, notes=notes)


def force_n(perception: Perception, ticks: Float64s) -> Float64s:
    """The force at ascending ticks [n], the sum of all channels along their directions, float64 [n, 3]."""
    forces, unit_n = np.zeros((len(ticks), 3)), 10.0**perception.unit_exponent
    for channel in perception.channels:
        if channel.direction is None or not any(channel.direction):
            raise channel.place.wrong("a force without a direction", "a direction of length 127")
        along = np.array(channel.direction, np.float64)
        along *= channel.gain * unit_n / np.linalg.norm(along)
        for band in channel.bands:
            if band.kind != "Curve":
                raise band.place.wrong(f"a band of type {band.kind}", "a Curve")
            for effect, first, stop in _governed(band, ticks):
                shares = _curve(band, effect, ticks[first:stop] - effect.position)
                forces[first:stop] += shares[:, None] * along
    if not np.isfinite(forces).all():
        raise perception.place.wrong("forces that are not finite", "finite newtons")
    return forces


def _magnitude(
    document: Hjif, perception: Perception, frames: int, rate_hz: float, notes: tuple[str, ...]
) -> ImportedEffect:
    """A force as the drive of one actuator."""
    ticks = np.arange(frames, dtype=np.float64) * (document.timescale / rate_hz)
    magnitude_n = np.linalg.norm(force_n(perception, ticks), axis=1)
    greatest_n = float(magnitude_n.max())
    if not 0 < greatest_n <= 1e6:
        raise perception.place.wrong(
            f"a greatest force of {greatest_n:g} N", "newtons above 0, up to a million"
        )
    drives = (magnitude_n / greatest_n).astype(np.float32).reshape(-1, 1, 1)
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
    seconds: float = (
        max((end_tick(band, document.timescale) for band in bands), default=0) / document.timescale
    )
    if seconds > MAX_SECONDS:
        raise perception.place.wrong(f"an effect of {seconds:g} s", f"at most {MAX_SECONDS:g} s")
    frames = (
        math.floor((seconds + 0.5 / document.timescale) * rate_hz + 1e-6) + 1
    )  # the last may be half a tick late
    _check_work(perception, frames)
    return checked_frames(document.place.file, frames, 1)


def _check_work(perception: Perception, instants: int) -> None:
    """Refuse so many bands that a look at each instant of each would take for ever."""
    bands = sum(len(channel.bands) + 1 for channel in perception.channels)
    if bands * instants > _MOST_WORK:
        raise perception.place.wrong(f"{bands} bands at {instants} instants", f"at most {_MOST_WORK} of both")


def _cells(perception: Perception, frames: int) -> tuple[list[Int64s], int, int, int]:
    """For each channel the actuators that it drives, counted row by row from the lower left; rows, columns,
    parts.
    """
    channels = perception.channels
    parts: dict[tuple[str, ...], list[int]] = {}
    for n, channel in enumerate(channels):
        parts.setdefault(channel.body, []).append(n)
    places = {}
    rows, columns, reached = 1, 0, 0
    for members in parts.values():
        extents = [one.resolution for one in (channels[n] for n in members) if one.resolution]
        extents += [(x + 1, y + 1) for n in members for x, y in channels[n].targets or ()]
        width, height = map(max, zip(*extents)) if extents else (len(members), 1)
        rows = max(rows, height)
        for place, n in enumerate(members):
            across, up = channels[n].resolution or (width, height)
            if not extents:
                x, y = np.array([place]), np.array([0])
            elif targets := channels[n].targets:
                x, y = np.array(sorted(set(targets)), np.int64).T
            else:
                y, x = np.divmod(np.arange(across * up), across)
            places[n], reached = (columns + x, y), reached + len(x)
            actuators = max(reached, rows * (columns + width))
            if actuators * frames > MAX_VALUES:
                found = f"{frames} frames of {actuators} actuators"
                raise perception.place.wrong(found, f"at most {MAX_VALUES} drives", "Take a lower rate.")
        columns += width
    return [y * columns + x for _, (x, y) in sorted(places.items())], rows, columns, len(parts)


def _images(of: Float32s, rows: int, columns: int) -> Float32s:
    """[actuators from the lower left, frames] as [frames, rows from the top, columns]."""
    return np.ascontiguousarray(of.reshape(rows, columns, -1).transpose(2, 0, 1)[:, ::-1])


# -- a band at the frames of a medium
# ------------------------------------------------------------------------------

SLOWEST_HZ: Final = 1.0
_LEAST_WINDOW_S: Final = 0.02


def wave_drive(
    times_s: Float64s, values: Float64s, at_s: Float64s, window_s: float
) -> tuple[Float64s, Float64s]:
    """Amplitudes and frequencies [m] at ascending seconds of a wave, lines between its samples [n], n at
    least 1.

    A frequency is counted over `window_s`, at least 0.02 s. It is 0 Hz where the signal is too slow for a
    vibration; the amplitude is then its magnitude.
    """
    slow = np.abs(np.interp(at_s, times_s, values)), np.zeros(len(at_s))
    nonzero = np.flatnonzero(values)
    turns = np.flatnonzero(np.diff(np.sign(values[nonzero])))
    if len(turns) < 2:
        return slow
    before, after = nonzero[turns], nonzero[turns + 1]
    share = values[before] / (values[before] - values[after])
    crossings_s = times_s[before] + share * (times_s[after] - times_s[before])
    bounds = np.concatenate([[0], after, [len(values)]])
    magnitudes = np.abs(values)
    peaks = np.maximum.reduceat(magnitudes, bounds[:-1])
    places = np.array(
        [first + int(np.argmax(magnitudes[first:stop])) for first, stop in zip(bounds, bounds[1:])]
    )
    half = max(window_s, _LEAST_WINDOW_S) / 2
    low, high = (np.clip(at_s + side, crossings_s[0], crossings_s[-1]) for side in (-half, half))
    passed = np.arange(len(crossings_s), dtype=np.float64)
    width = high - low
    counted = np.interp(high, crossings_s, passed) - np.interp(low, crossings_s, passed)
    nearest = np.clip(np.searchsorted(crossings_s, at_s), 1, len(crossings_s) - 1)
    own = 1 / (2 * np.maximum(np.diff(crossings_s)[nearest - 1], 1e-9))
    hertz = np.where(width > half / 4, counted / (2 * np.maximum(width, 1e-9)), own)
    is_wave = hertz >= SLOWEST_HZ
    amplitudes = np.where(is_wave, np.interp(at_s, times_s[places], peaks), slow[0])
    return amplitudes, np.where(is_wave, hertz, 0.0)


_DEFAULT_HZ: Final = 150.0
"""Of a wave without a frequency, as far as its limits allow."""

_SLACK: Final = 0.5
"""Ticks by which a frame may lie outside an effect: one between two ticks is told at the nearer one."""


def end_tick(band: Band, timescale: int) -> float:
    """The tick at which the last effect of a band is over; 0 for a band without any."""
    if band.kind == "WaveletWave":
        return max(
            (one.position + len(one.samples) * timescale / band.upper_hz for one in band.effects), default=0
        )
    after = math.ceil(TRANSIENT_S * timescale) if band.kind == "Transient" else 0
    return max(
        (one.position + int(one.ticks[-1]) + after for one in band.effects if len(one.ticks)), default=0
    )


def drive_of(bands: Iterable[Band], frames: int, ticks_per_frame: float, timescale: int) -> Drive:
    """The drive that all bands of a channel make together, before its gain."""
    total, places = Drive.silent(frames), np.arange(frames, dtype=np.float64) * ticks_per_frame
    for band in bands:
        if band.kind == "Transient":
            total.add(_transients(band, frames, ticks_per_frame, timescale))
        elif band.kind == "WaveletWave":
            total.add(_wavelets(band, places, timescale))
        else:
            total.add(_continuous(band, places, ticks_per_frame, timescale))
    return total


def _governed(band: Band, places: Float64s) -> Iterable[tuple[Effect, int, int]]:
    """Each effect with the places, from and to, at which it is felt."""
    effects = [one for one in band.effects if len(one.ticks)]
    low, high = (
        [one.position - _SLACK for one in effects],
        [one.position + one.ticks[-1] + _SLACK for one in effects],
    )
    begins = np.searchsorted(places, low, side="left").tolist()
    ends = np.searchsorted(places, high, side="right").tolist()
    for effect, first, stop, following in zip(effects, begins, ends, [*begins[1:], len(places)]):
        yield effect, first, max(first, min(stop, following))


def _wavelets(band: Band, places: Float64s, timescale: int) -> Drive:
    """Blocks end to end, each run of them that is not silent as one wave."""
    drive = Drive.silent(len(places))
    window_s = float(places[1] - places[0]) / timescale if len(places) > 1 else 0.0
    runs: list[tuple[float, list[Float64s]]] = []
    end = -math.inf
    for block in band.effects:
        if not block.samples.any():
            continue
        if abs(block.position - end) > 1:
            runs.append((block.position, []))
        runs[-1][1].append(block.samples)
        end = block.position + len(block.samples) * timescale / band.upper_hz
    for position, blocks in runs:
        samples = np.concatenate(blocks)
        ticks = position + np.arange(len(samples)) * (timescale / band.upper_hz)
        first, stop = np.searchsorted(places, [ticks[0] - _SLACK, ticks[-1] + _SLACK]).tolist()
        if first == stop:
            first = min(first, len(places) - 1)
            stop = first + 1
        at = slice(first, stop)
        amplitudes, hertz = wave_drive(ticks / timescale, samples, places[at] / timescale, window_s)
        drive.amplitudes[at] = np.maximum(drive.amplitudes[at], amplitudes)
        drive.frequencies_hz[at] = np.where(hertz > 0, np.clip(hertz, band.lower_hz, band.upper_hz), 0)
    return drive


def _continuous(band: Band, places: Float64s, ticks_per_frame: float, timescale: int) -> Drive:
    """A Curve or a VectorialWave."""
    drive = Drive.silent(len(places))
    for effect, first, stop in _governed(band, places):
        where, at = slice(first, stop), places[first:stop] - effect.position
        if first == stop:  # between two frames
            middle = effect.position + int(effect.ticks[-1]) / 2
            frame = min(round(middle / ticks_per_frame), len(places) - 1)
            where, at = slice(frame, frame + 1), effect.ticks.astype(np.float64)
        if band.kind == "Curve":
            amplitudes, hertz = _drawn(band, effect, at, ticks_per_frame, timescale)
        else:
            amplitudes = np.abs(_linear(effect, effect.amplitudes, at, 1.0))
            hertz = np.clip(
                _linear(effect, effect.frequencies_hz, at, _DEFAULT_HZ), band.lower_hz, band.upper_hz
            )
        if first == stop:
            strongest = int(np.argmax(amplitudes))
            if amplitudes[strongest] <= drive.amplitudes[where][0]:
                continue
            amplitudes, hertz = amplitudes[strongest], hertz[strongest]
        drive.amplitudes[where], drive.frequencies_hz[where] = amplitudes, hertz
    return drive


def _linear(effect: Effect, values: Float64s, at: Float64s, default: float) -> Float64s:
    """The values of the keyframes that have one, with lines between them."""
    known = ~np.isnan(values)
    return np.interp(at, effect.ticks[known], values[known]) if known.any() else np.full(len(at), default)


def _curve(band: Band, effect: Effect, at: Float64s) -> Float64s:
    known = ~np.isnan(effect.amplitudes)
    ticks, values = effect.ticks[known], effect.amplitudes[known]
    if band.curve not in ("Cubic", "Akima") or len(ticks) < 2:
        return _linear(effect, effect.amplitudes, at, 0.0)
    if band.curve == "Akima":
        from scipy.interpolate import Akima1DInterpolator

        own = np.append(np.diff(ticks) > 0, True)  # of keyframes on one tick the last
        if own.sum() > 1:
            drawn = Akima1DInterpolator(ticks[own], values[own])(np.clip(at, ticks[own][0], ticks[-1]))
            return np.clip(np.asarray(drawn, np.float64), -1, 1)
    after = np.clip(np.searchsorted(ticks, at, side="right"), 1, len(ticks) - 1)
    width = np.maximum(ticks[after] - ticks[after - 1], 1)
    share = np.clip((at - ticks[after - 1]) / width, 0, 1)
    eased: Float64s = values[after - 1] + (values[after] - values[after - 1]) * share**2 * (3 - 2 * share)
    return eased


def _drawn(
    band: Band, effect: Effect, at: Float64s, ticks_per_frame: float, timescale: int
) -> tuple[Float64s, Float64s]:
    """A Curve: a wave where it swings about nothing, else its magnitude."""
    known, magnitudes = ~np.isnan(effect.amplitudes), np.abs(_curve(band, effect, at))
    if not known.any():
        return magnitudes, np.zeros(len(at))
    times_s = effect.ticks[known] / timescale
    amplitudes, hertz = wave_drive(
        times_s, effect.amplitudes[known], at / timescale, ticks_per_frame / timescale
    )
    is_wave = hertz > 0
    return (
        np.where(is_wave, amplitudes, magnitudes),
        np.where(is_wave, np.clip(hertz, max(band.lower_hz, 1), max(band.upper_hz, 1)), 0),
    )


def _transients(band: Band, frames: int, ticks_per_frame: float, timescale: int) -> Drive:
    drive = Drive.silent(frames)
    if not band.effects:
        return drive
    ticks = np.concatenate([one.position + one.ticks for one in band.effects])
    amplitudes = np.abs(np.concatenate([one.amplitudes for one in band.effects]))
    hertz = np.concatenate([one.frequencies_hz for one in band.effects])
    hertz[np.isnan(hertz)] = np.clip(_DEFAULT_HZ, band.lower_hz, band.upper_hz)
    begins = np.round(ticks / ticks_per_frame).astype(np.int64)
    length = TRANSIENT_S * timescale / ticks_per_frame
    for after in range(max(1, math.ceil(length))):
        at = begins + after
        there = (at < frames) & ~np.isnan(amplitudes)
        np.add.at(drive.amplitudes, at[there], amplitudes[there] * (1 - after / max(length, 1)))
        drive.frequencies_hz[at[there]] = hertz[there]
    return drive
