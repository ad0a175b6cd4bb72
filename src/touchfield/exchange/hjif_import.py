"""Converts an effect in HJIF, the JSON format of MPEG haptics (ISO/IEC 23090-31), to the drives of an array
of actuators, or to a force over time.

An array is made from the channels of the first perception in `MODALITIES`. A channel drives the actuators
that it targets; one without targets drives all of its array, and if no channel states an array, the channels
form a row. Body parts are placed side by side, in order of appearance. Where several channels overlap, their
amplitudes are added, up to 1, and the frequency is that of the strongest. If another perception has a force
along the normal of each actuator of this array, the effect has both parts, and the force of a full drive is
the greatest gain of the force.

Drives are sampled at the frames of a rate and are linear between frames, so that faster changes are smoothed.

The result is the drive of an actuator, not its waveform. A VectorialWave gives its amplitude and frequency,
whatever its base signal. A Transient gives a burst that decays to zero within `TRANSIENT_S`. A block of
wavelets gives envelope and frequency (`wave_drive`), and so does a Curve that is a vibration sampled point by
point, as the reference encoder writes signals below 72 Hz. Any other Curve gives its magnitude, without a
frequency. In a band, the latest effect that has started is active, as in the reference decoder. An effect
that is too short to include a frame is placed at the nearest one.

**Sampled waves.** A half wave lies between two zero crossings. The envelope is the polyline through the
largest value of each half wave; the number of half waves in a window gives the frequency. A signal with fewer
than two crossings, or slower than `MIN_FREQUENCY_HZ`, is not a vibration: it has a magnitude and no
frequency.
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
"""Perception modalities that actuators can show.

"Other" is shown as a vibration: the reference encoder uses it for every sound and pattern that it is given.
"""

_MAX_WORK: Final = 1 << 28


def read_hjif_array(path: str | Path, rate_hz: float = DEFAULT_RATE_HZ) -> ImportedEffect:
    """Read an ``.hjif`` or ``.hmpg`` file as drives of an array, sampled at `rate_hz`.

    A force of several directions becomes the drive of one actuator, its magnitude. Raises SourceError as
    `read_hjif` does, and if nothing in it is haptic or it is longer than an hour; InvalidArgument if the rate
    is out of range, or there would be too many drives.
    """
    check_rate(rate_hz)
    document = read_hjif(path)
    supported = [candidate for candidate in document.perceptions if candidate.modality in MODALITIES]
    if not supported:
        raise document.node.wrong(
            "perceptions of " + ", ".join(sorted({candidate.modality for candidate in document.perceptions})),
            "one of " + ", ".join(MODALITIES),
        )
    perception = next((candidate for candidate in supported if candidate.modality != "Other"), supported[0])
    normal = _normal_force(document, perception)
    used = (perception,) if normal is None else (perception, normal)
    notes = _notes(document, used)
    frames = max(_frames(document, item, rate_hz) for item in used)
    if perception.modality == "Force" and any(channel.direction for channel in perception.channels):
        return _magnitude(document, perception, frames, rate_hz, notes)
    _, rows, columns, parts = _cells(perception, frames)
    if parts > 1:
        notes += (f"Its {parts} body parts are placed side by side.",)
    total, strongest, hertz = _actuators(document, perception, frames, rate_hz)
    unknown = (strongest > 0) & (hertz == 0)
    if unknown.any():
        percent = 100 * float(unknown.sum() / (strongest > 0).sum())
        notes += (f"{percent:.3g} % of the signal has no frequency of its own, and is played at a device's.",)
    drives, frequencies = (_images(values, rows, columns) for values in (total, hertz))
    known_hz = frequencies if frequencies.any() else None
    if normal is None:
        effect = ArrayEffect(float(rate_hz), drives, known_hz)
        return ImportedEffect(effect, perception.device_name, notes=notes)
    full_n = max(channel.gain for channel in normal.channels)
    forces, _, _ = _actuators(document, normal, frames, rate_hz, full_n)
    effect = ArrayEffect.from_parts(float(rate_hz), _images(forces, rows, columns), drives, known_hz)
    return ImportedEffect(effect, perception.device_name, full_n * 10.0**normal.unit_exponent, notes)


def _normal_force(document: Hjif, perception: Perception) -> Perception | None:
    """Return the perception of forces along the normals of the actuators of another one, or None."""
    layout = [(channel.body, channel.resolution, channel.targets) for channel in perception.channels]
    for other in document.perceptions:
        if other is perception or other.modality != "Force" or perception.modality == "Force":
            continue
        is_normal = all(
            channel.direction is not None and channel.direction[:2] == (0, 0) and channel.direction[2] > 0
            for channel in other.channels
        )
        same = [(channel.body, channel.resolution, channel.targets) for channel in other.channels] == layout
        greatest = max((channel.gain for channel in other.channels), default=0.0)
        if is_normal and same and 0 < greatest * 10.0**other.unit_exponent <= 1e6:
            return other
    return None


def _actuators(
    document: Hjif, perception: Perception, frames: int, rate_hz: float, full_gain: float = 1.0
) -> tuple[Float32s, Float32s, Float32s]:
    """Return sums, strongest amplitudes, frequencies: float32 [actuators from the lower left, frames] each.

    Amplitudes are fractions of `full_gain`, up to 1.
    """
    cells, rows, columns, _ = _cells(perception, frames)
    total, strongest, hertz = (np.zeros((rows * columns, frames), np.float32) for _ in range(3))
    for channel, indices in zip(perception.channels, cells):
        drive = drive_of(channel.bands, frames, document.timescale / rate_hz, document.timescale)
        amplitudes = np.minimum(drive.amplitudes * (channel.gain / full_gain), 1).astype(np.float32)
        stronger = amplitudes > strongest[indices]
        hertz[indices] = np.where(stronger, drive.frequencies_hz.astype(np.float32), hertz[indices])
        strongest[indices] = np.maximum(strongest[indices], amplitudes)
        total[indices] = np.minimum(total[indices] + amplitudes, 1)
    return total, strongest, hertz


def force_n(perception: Perception, ticks: Float64s) -> Float64s:
    """Return the force at ascending ticks [n], newtons, float64 [n, 3].

    It is the sum of all channels along their directions.
    """
    forces, unit_n = np.zeros((len(ticks), 3)), 10.0**perception.unit_exponent
    for channel in perception.channels:
        if channel.direction is None or not any(channel.direction):
            raise channel.node.wrong("a force without a direction", "a direction of length 127")
        direction = np.array(channel.direction, np.float64)
        direction *= channel.gain * unit_n / np.linalg.norm(direction)
        for band in channel.bands:
            if band.kind != "Curve":
                raise band.node.wrong(f"a band of type {band.kind}", "a Curve")
            for effect, first, stop in _active_ranges(band, ticks):
                amplitudes = _curve_values(band, effect, ticks[first:stop] - effect.position)
                forces[first:stop] += amplitudes[:, None] * direction
    if not np.isfinite(forces).all():
        raise perception.node.wrong("forces that are not finite", "finite newtons")
    return forces


def _magnitude(
    document: Hjif, perception: Perception, frames: int, rate_hz: float, notes: tuple[str, ...]
) -> ImportedEffect:
    """Convert a force to the drive of one actuator."""
    ticks = np.arange(frames, dtype=np.float64) * (document.timescale / rate_hz)
    magnitude_n = np.linalg.norm(force_n(perception, ticks), axis=1)
    greatest_n = float(magnitude_n.max())
    if not 0 < greatest_n <= 1e6:
        raise perception.node.wrong(
            f"a greatest force of {greatest_n:g} N", "newtons above 0, up to a million"
        )
    drives = (magnitude_n / greatest_n).astype(np.float32).reshape(-1, 1, 1)
    notes += ("The magnitude of the force is used as the drive of one actuator.",)
    return ImportedEffect(ArrayEffect(float(rate_hz), drives), perception.device_name, greatest_n, notes)


def _notes(document: Hjif, used: tuple[Perception, ...]) -> tuple[str, ...]:
    omitted = [other.modality for other in document.perceptions if not any(other is item for item in used)]
    notes = (
        (f"Left out: {len(omitted)} other perceptions ({', '.join(sorted(set(omitted)))}).",)
        if omitted
        else ()
    )
    if used[0].modality == "Other":
        notes = (*notes, 'Its perception is of type "Other", without a unit: it is read as a vibration.')
    return notes


def _frames(document: Hjif, perception: Perception, rate_hz: float) -> int:
    bands = [band for channel in perception.channels for band in channel.bands]
    seconds: float = (
        max((end_tick(band, document.timescale) for band in bands), default=0) / document.timescale
    )
    if seconds > MAX_SECONDS:
        raise perception.node.wrong(f"an effect of {seconds:g} s", f"at most {MAX_SECONDS:g} s")
    # the last frame may be half a tick late
    frames = math.floor((seconds + 0.5 / document.timescale) * rate_hz + 1e-6) + 1
    _check_work(perception, frames)
    return checked_frames(document.node.file, frames, 1)


def _check_work(perception: Perception, instants: int) -> None:
    """Refuse a number of bands that would take too long to evaluate at each instant."""
    bands = sum(len(channel.bands) + 1 for channel in perception.channels)
    if bands * instants > _MAX_WORK:
        raise perception.node.wrong(f"{bands} bands at {instants} instants", f"at most {_MAX_WORK} of both")


def _cells(perception: Perception, frames: int) -> tuple[list[Int64s], int, int, int]:
    """Return the actuators of each channel, and the number of rows, columns and body parts.

    Actuators are counted row by row from the lower left.
    """
    channels = perception.channels
    parts: dict[tuple[str, ...], list[int]] = {}
    for n, channel in enumerate(channels):
        parts.setdefault(channel.body, []).append(n)
    positions = {}
    rows, columns, actuator_count = 1, 0, 0
    for members in parts.values():
        extents = [member.resolution for member in (channels[n] for n in members) if member.resolution]
        extents += [(x + 1, y + 1) for n in members for x, y in channels[n].targets or ()]
        width, height = map(max, zip(*extents)) if extents else (len(members), 1)
        rows = max(rows, height)
        for index, n in enumerate(members):
            across, up = channels[n].resolution or (width, height)
            if not extents:
                x, y = np.array([index]), np.array([0])
            elif targets := channels[n].targets:
                x, y = np.array(sorted(set(targets)), np.int64).T
            else:
                y, x = np.divmod(np.arange(across * up), across)
            positions[n], actuator_count = (columns + x, y), actuator_count + len(x)
            actuators = max(actuator_count, rows * (columns + width))
            if actuators * frames > MAX_VALUES:
                found = f"{frames} frames of {actuators} actuators"
                raise perception.node.wrong(found, f"at most {MAX_VALUES} drives", "Take a lower rate.")
        columns += width
    return [y * columns + x for _, (x, y) in sorted(positions.items())], rows, columns, len(parts)


def _images(values: Float32s, rows: int, columns: int) -> Float32s:
    """Rearrange [actuators from the lower left, frames] to [frames, rows from the top, columns]."""
    return np.ascontiguousarray(values.reshape(rows, columns, -1).transpose(2, 0, 1)[:, ::-1])


# -- a band at the frames of a medium ----------------------------------------------------------------------

MIN_FREQUENCY_HZ: Final = 1.0
_MIN_WINDOW_S: Final = 0.02


def wave_drive(
    times_s: Float64s, values: Float64s, at_s: Float64s, window_s: float
) -> tuple[Float64s, Float64s]:
    """Return amplitudes and frequencies [m] of a wave at ascending times in seconds.

    The wave is linear between its samples [n], n at least 1. A frequency is counted over `window_s`, at least
    0.02 s. It is 0 Hz where the signal is too slow for a vibration; the amplitude is then its magnitude.
    """
    slow = np.abs(np.interp(at_s, times_s, values)), np.zeros(len(at_s))
    nonzero = np.flatnonzero(values)
    sign_changes = np.flatnonzero(np.diff(np.sign(values[nonzero])))
    if len(sign_changes) < 2:
        return slow
    before, after = nonzero[sign_changes], nonzero[sign_changes + 1]
    fraction = values[before] / (values[before] - values[after])
    crossings_s = times_s[before] + fraction * (times_s[after] - times_s[before])
    bounds = np.concatenate([[0], after, [len(values)]])
    magnitudes = np.abs(values)
    peaks = np.maximum.reduceat(magnitudes, bounds[:-1])
    peak_indices = np.array(
        [first + int(np.argmax(magnitudes[first:stop])) for first, stop in zip(bounds, bounds[1:])]
    )
    half = max(window_s, _MIN_WINDOW_S) / 2
    low, high = (np.clip(at_s + side, crossings_s[0], crossings_s[-1]) for side in (-half, half))
    crossing_numbers = np.arange(len(crossings_s), dtype=np.float64)
    width = high - low
    counted = np.interp(high, crossings_s, crossing_numbers) - np.interp(low, crossings_s, crossing_numbers)
    nearest = np.clip(np.searchsorted(crossings_s, at_s), 1, len(crossings_s) - 1)
    nearest_hz = 1 / (2 * np.maximum(np.diff(crossings_s)[nearest - 1], 1e-9))
    hertz = np.where(width > half / 4, counted / (2 * np.maximum(width, 1e-9)), nearest_hz)
    is_wave = hertz >= MIN_FREQUENCY_HZ
    amplitudes = np.where(is_wave, np.interp(at_s, times_s[peak_indices], peaks), slow[0])
    return amplitudes, np.where(is_wave, hertz, 0.0)


_DEFAULT_HZ: Final = 150.0
"""Frequency of a wave without one, within its band's limits."""

_SLACK: Final = 0.5
"""Ticks by which a frame may lie outside an effect, from rounding to ticks."""


def end_tick(band: Band, timescale: int) -> float:
    """Return the tick at which the last effect of a band ends; 0 without effects."""
    if band.kind == "WaveletWave":
        return max(
            (effect.position + len(effect.samples) * timescale / band.upper_hz for effect in band.effects),
            default=0,
        )
    after = math.ceil(TRANSIENT_S * timescale) if band.kind == "Transient" else 0
    return max(
        (effect.position + int(effect.ticks[-1]) + after for effect in band.effects if len(effect.ticks)),
        default=0,
    )


def drive_of(bands: Iterable[Band], frames: int, ticks_per_frame: float, timescale: int) -> Drive:
    """Return the sum of the drives of all bands of a channel, before its gain."""
    total, ticks = Drive.silent(frames), np.arange(frames, dtype=np.float64) * ticks_per_frame
    for band in bands:
        if band.kind == "Transient":
            total.add(_transients(band, frames, ticks_per_frame, timescale))
        elif band.kind == "WaveletWave":
            total.add(_wavelets(band, ticks, timescale))
        else:
            total.add(_continuous(band, ticks, ticks_per_frame, timescale))
    return total


def _active_ranges(band: Band, ticks: Float64s) -> Iterable[tuple[Effect, int, int]]:
    """Yield each effect, with the start and stop of the ticks at which it is active."""
    effects = [keyed_effect for keyed_effect in band.effects if len(keyed_effect.ticks)]
    low, high = (
        [keyed_effect.position - _SLACK for keyed_effect in effects],
        [keyed_effect.position + keyed_effect.ticks[-1] + _SLACK for keyed_effect in effects],
    )
    starts = np.searchsorted(ticks, low, side="left").tolist()
    stops = np.searchsorted(ticks, high, side="right").tolist()
    for effect, first, stop, following in zip(effects, starts, stops, [*starts[1:], len(ticks)]):
        yield effect, first, max(first, min(stop, following))


def _wavelets(band: Band, frame_ticks: Float64s, timescale: int) -> Drive:
    """Return the drive of blocks of wavelets; consecutive blocks that are not silent form one wave."""
    drive = Drive.silent(len(frame_ticks))
    window_s = float(frame_ticks[1] - frame_ticks[0]) / timescale if len(frame_ticks) > 1 else 0.0
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
        first, stop = np.searchsorted(frame_ticks, [ticks[0] - _SLACK, ticks[-1] + _SLACK]).tolist()
        if first == stop:
            first = min(first, len(frame_ticks) - 1)
            stop = first + 1
        at = slice(first, stop)
        amplitudes, hertz = wave_drive(ticks / timescale, samples, frame_ticks[at] / timescale, window_s)
        drive.amplitudes[at] = np.maximum(drive.amplitudes[at], amplitudes)
        drive.frequencies_hz[at] = np.where(hertz > 0, np.clip(hertz, band.lower_hz, band.upper_hz), 0)
    return drive


def _continuous(band: Band, frame_ticks: Float64s, ticks_per_frame: float, timescale: int) -> Drive:
    """Return the drive of a Curve or a VectorialWave."""
    drive = Drive.silent(len(frame_ticks))
    for effect, first, stop in _active_ranges(band, frame_ticks):
        where, at = slice(first, stop), frame_ticks[first:stop] - effect.position
        if first == stop:  # between two frames
            middle = effect.position + int(effect.ticks[-1]) / 2
            frame = min(round(middle / ticks_per_frame), len(frame_ticks) - 1)
            where, at = slice(frame, frame + 1), effect.ticks.astype(np.float64)
        if band.kind == "Curve":
            amplitudes, hertz = _sample_curve(band, effect, at, ticks_per_frame, timescale)
        else:
            amplitudes = np.abs(_linear_values(effect, effect.amplitudes, at, 1.0))
            hertz = np.clip(
                _linear_values(effect, effect.frequencies_hz, at, _DEFAULT_HZ), band.lower_hz, band.upper_hz
            )
        if first == stop:
            strongest = int(np.argmax(amplitudes))
            if amplitudes[strongest] <= drive.amplitudes[where][0]:
                continue
            amplitudes, hertz = amplitudes[strongest], hertz[strongest]
        drive.amplitudes[where], drive.frequencies_hz[where] = amplitudes, hertz
    return drive


def _linear_values(effect: Effect, values: Float64s, at: Float64s, default: float) -> Float64s:
    """Return values at some ticks, linear between the keyframes that have a value."""
    has_value = ~np.isnan(values)
    return (
        np.interp(at, effect.ticks[has_value], values[has_value])
        if has_value.any()
        else np.full(len(at), default)
    )


def _curve_values(band: Band, effect: Effect, at: Float64s) -> Float64s:
    has_value = ~np.isnan(effect.amplitudes)
    ticks, values = effect.ticks[has_value], effect.amplitudes[has_value]
    if band.curve not in ("Cubic", "Akima") or len(ticks) < 2:
        return _linear_values(effect, effect.amplitudes, at, 0.0)
    if band.curve == "Akima":
        from scipy.interpolate import Akima1DInterpolator

        is_last = np.append(np.diff(ticks) > 0, True)  # the last keyframe of each tick
        if is_last.sum() > 1:
            values_at = Akima1DInterpolator(ticks[is_last], values[is_last])(
                np.clip(at, ticks[is_last][0], ticks[-1])
            )
            return np.clip(np.asarray(values_at, np.float64), -1, 1)
    after = np.clip(np.searchsorted(ticks, at, side="right"), 1, len(ticks) - 1)
    width = np.maximum(ticks[after] - ticks[after - 1], 1)
    fraction = np.clip((at - ticks[after - 1]) / width, 0, 1)
    eased: Float64s = values[after - 1] + (values[after] - values[after - 1]) * fraction**2 * (
        3 - 2 * fraction
    )
    return eased


def _sample_curve(
    band: Band, effect: Effect, at: Float64s, ticks_per_frame: float, timescale: int
) -> tuple[Float64s, Float64s]:
    """Return the drive of a Curve: a wave where it oscillates about zero, else its magnitude."""
    has_value, magnitudes = ~np.isnan(effect.amplitudes), np.abs(_curve_values(band, effect, at))
    if not has_value.any():
        return magnitudes, np.zeros(len(at))
    times_s = effect.ticks[has_value] / timescale
    amplitudes, hertz = wave_drive(
        times_s, effect.amplitudes[has_value], at / timescale, ticks_per_frame / timescale
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
    ticks = np.concatenate([effect.position + effect.ticks for effect in band.effects])
    amplitudes = np.abs(np.concatenate([effect.amplitudes for effect in band.effects]))
    hertz = np.concatenate([effect.frequencies_hz for effect in band.effects])
    hertz[np.isnan(hertz)] = np.clip(_DEFAULT_HZ, band.lower_hz, band.upper_hz)
    starts = np.round(ticks / ticks_per_frame).astype(np.int64)
    length = TRANSIENT_S * timescale / ticks_per_frame
    for after in range(max(1, math.ceil(length))):
        at = starts + after
        is_inside = (at < frames) & ~np.isnan(amplitudes)
        np.add.at(drive.amplitudes, at[is_inside], amplitudes[is_inside] * (1 - after / max(length, 1)))
        drive.frequencies_hz[at[is_inside]] = hertz[is_inside]
    return drive
