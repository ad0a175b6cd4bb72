"""HJIF (ISO/IEC 23090-31) read into values: every member that matters is checked as the published schemas have it.

The file comes from strangers: its length is bounded before it is read, whatever is made of it is bounded by its
bytes, and what breaks the schema is told in one line that names the place in the JSON.
"""

from __future__ import annotations

import base64
import binascii
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.adapters.hjif_format import DEFAULT_TIMESCALE, MAX_CHANNELS, MAX_TIMESCALE
from touchfield.adapters.json_values import JsonValue, read_json
from touchfield.adapters.wavelet_block import MAX_BLOCK, MIN_BLOCK, block_samples
from touchfield.medium.vibration import MAX_FREQUENCY_HZ

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["Band", "Channel", "Effect", "Hjif", "Perception", "hjif_of", "read_hjif"]

MAX_BYTES: Final = 1 << 26
_MAX_TICK: Final = (1 << 31) - 1
_MODALITIES: Final = (
    "Pressure", "Acceleration", "Velocity", "Position", "Temperature", "Vibrotactile", "Water", "Wind", "Force",
    "Electrotactile", "Vibrotactile Texture", "Stiffness", "Friction", "Humidity", "User-defined Temporal",
    "User-defined Spatial", "Other",
)  # fmt: skip
_BANDS: Final = ("WaveletWave", "VectorialWave", "Curve", "Transient")
_CURVES: Final = ("Linear", "Cubic", "Akima", "Bezier", "BSpline", "Unknown")
_SIGNALS: Final = ("Sine", "Square", "Triangle", "SawToothUp", "SawToothDown")
_LARGEST_VECTOR: Final = 127
_MAX_MASK: Final = (1 << 32) - 1
_MOST_SAMPLES: Final = 1 << 21
"""Of all wavelets of a file: four minutes at 8 kHz."""


@dataclass(frozen=True)
class Effect:
    """One effect of a band.

    Attributes
    ----------
    position : int
        Where it begins, ticks.
    base_signal : str
    ticks : int64 [n]
        Of the keyframes, from `position`, never falling.
    amplitudes : float64 [n]
        NaN where a keyframe has none.
    frequencies_hz : float64 [n]
        NaN where a keyframe has none.
    samples : float64 [m] or None
        Of a block of wavelets: so many of the band's upper limit a second.
    """

    position: int
    base_signal: str
    ticks: NDArray[np.int64]
    amplitudes: Float64s
    frequencies_hz: Float64s
    samples: Float64s | None = None


@dataclass(frozen=True)
class Band:
    """One band of a channel; `effects` by position."""

    kind: str
    curve: str
    lower_hz: float
    upper_hz: float
    effects: tuple[Effect, ...]
    place: JsonValue


@dataclass(frozen=True)
class Channel:
    """One channel.

    `resolution` is (columns, rows) or None, `targets` are (column, row) from the lower left, and `body` names the
    body part, whatever way it is told.
    """

    gain: float
    resolution: tuple[int, int] | None
    targets: tuple[tuple[int, int], ...] | None
    body: tuple[str, ...]
    direction: tuple[int, int, int] | None
    bands: tuple[Band, ...]
    place: JsonValue


@dataclass(frozen=True)
class Perception:
    """One perception: its modality, the power of ten of its unit, its reference device and its channels."""

    modality: str
    unit_exponent: int
    device_name: str
    channels: tuple[Channel, ...]
    place: JsonValue


@dataclass(frozen=True)
class Hjif:
    """A whole file: ticks a second, and what is perceived."""

    timescale: int
    perceptions: tuple[Perception, ...]
    place: JsonValue


@dataclass
class _Told:
    """Ticks a second, and how many samples of wavelets there were so far."""

    timescale: int
    samples: int = 0


def read_hjif(path: str | Path) -> Hjif:
    """The perceptions of an ``.hjif`` file.

    Parameters
    ----------
    path : Path

    Raises
    ------
    SourceError
        If the file cannot be read, is longer than 64 MiB, is no JSON or breaks the schema; and where an effect refers
        to a library or is composed of others, or a curve is of a type that nobody draws alike.
    """
    return hjif_of(read_json(path, MAX_BYTES, "an HJIF file"))


def hjif_of(root: JsonValue) -> Hjif:
    """The perceptions of a document that was read; errors as `read_hjif`."""
    version = root.at("version")
    if not re.fullmatch(r"[0-9]{4}(-[0-9])?", version.text()):
        raise version.refused('a year such as "2023"')
    for key in ("profile", "date", "description"):
        root.at(key).text()
    root.at("level").whole(0, _MAX_TICK)
    for avatar in root.at("avatars").each():
        avatar.members()
    timescale = root.get("timescale")
    ticks = DEFAULT_TIMESCALE if timescale is None else timescale.whole(1, MAX_TIMESCALE)
    told = _Told(ticks)
    return Hjif(ticks, tuple(_perception(one, told) for one in root.at("perceptions").each(least=1)), root)


def _perception(one: JsonValue, told: _Told) -> Perception:
    one.at("id").whole(0, _MAX_TICK)
    modality = one.at("perception_modality").text(_MODALITIES)
    one.at("description").text()
    one.at("avatar_id").whole(0, _MAX_TICK)
    one.at("effect_library").items()
    exponent = one.get("perception_unit_exponent")
    names: list[str] = []
    devices = one.get("reference_devices")
    for device in () if devices is None else devices.each():
        device.at("id").whole(1, _MAX_TICK)
        names.append(device.at("name").text())
    channels = one.at("channels")
    if len(channels.items(least=1)) > MAX_CHANNELS:
        raise channels.wrong(f"{len(channels.items())} channels", f"at most {MAX_CHANNELS}")
    return Perception(
        modality,
        0 if exponent is None else exponent.whole(-30, 30),
        names[0] if len(names) == 1 else "",
        tuple(_channel(channel, told) for channel in channels.each()),
        one,
    )


def _channel(one: JsonValue, told: _Told) -> Channel:
    one.at("id").whole(0, _MAX_TICK)
    one.at("description").text()
    mixing = one.at("mixing_coefficient").number(0)
    gain = one.at("gain").number(0) * mixing
    mask, parts = one.get("body_part_mask"), one.get("body_part_target")
    bits = 0 if mask is None else mask.whole(0, _MAX_MASK)
    body = () if parts is None else tuple(part.text() for part in parts.each())
    resolution, direction = one.get("actuator_resolution"), one.get("direction")
    size = None if resolution is None else _vector(resolution, 1)
    if resolution is not None and size is not None and size[2] != 1:
        raise resolution.wrong(f"an array {size[2]} actuators deep", "a flat one, Z of 1")
    return Channel(
        gain,
        None if size is None else size[:2],
        _targets(one.get("actuator_target"), size),
        body or ((f"mask {bits:#x}",) if bits else ()),
        None if direction is None else _vector(direction, -_LARGEST_VECTOR),
        tuple(_band(band, told) for band in one.at("bands").each()),
        one,
    )


def _targets(targets: JsonValue | None, size: tuple[int, int, int] | None) -> tuple[tuple[int, int], ...] | None:
    if targets is None:
        return None
    found = []
    for target in targets.each():
        x, y, z = _vector(target, 0)
        if z or (size is not None and (x >= size[0] or y >= size[1])):
            within = "Z of 0" if size is None else f"a place within {size[0]} x {size[1]} x 1"
            raise target.wrong(f"the actuator ({x}, {y}, {z})", within)
        found.append((x, y))
    return tuple(found)


def _vector(one: JsonValue, low: int) -> tuple[int, int, int]:
    x, y, z = (one.at(key).whole(low, _LARGEST_VECTOR) for key in ("X", "Y", "Z"))
    return x, y, z


def _band(one: JsonValue, told: _Told) -> Band:
    kind = one.at("band_type").text(_BANDS)
    curve = one.get("curve_type")
    limits = [one.at(f"{end}_frequency_limit").number(0, MAX_FREQUENCY_HZ) for end in ("lower", "upper")]
    if limits[0] > limits[1]:
        raise one.wrong(f"limits of {limits[0]:g} and {limits[1]:g} Hz", "the lower one first")
    shape = "Linear" if curve is None else curve.text(_CURVES)
    if kind == "Curve" and shape not in ("Linear", "Cubic", "Akima", "Unknown"):
        raise one.wrong(f"a curve of type {shape}", "Linear, Cubic or Akima")
    if kind == "WaveletWave":
        effects = _wavelets(one, limits[1], told)
    else:
        effects = [_effect(effect) for effect in one.at("effects").each()]
    effects.sort(key=lambda effect: effect.position)
    return Band(kind, shape, limits[0], limits[1], tuple(effects), one)


def _wavelets(one: JsonValue, rate_hz: float, told: _Told) -> list[Effect]:
    """The blocks of a band of wavelets."""
    ticks = one.at("block_length").whole(1, _MAX_TICK)
    length = round(ticks * rate_hz / told.timescale)
    if length not in [MIN_BLOCK << n for n in range(20) if MIN_BLOCK << n <= MAX_BLOCK]:
        expected = f"a power of two from {MIN_BLOCK} to {MAX_BLOCK}"
        raise one.at("block_length").wrong(f"{ticks} ticks, {length} samples at {rate_hz:g} Hz", expected)
    effects = one.at("effects")
    told.samples += len(effects.items()) * length
    if told.samples > _MOST_SAMPLES:
        found = f"{len(effects.items())} blocks of {length} samples, {told.samples} with those before"
        raise effects.wrong(found, f"at most {_MOST_SAMPLES}")
    blocks = []
    for effect in effects.each():
        _basis(effect)
        position, text = effect.get("position"), effect.at("wavelet_stream")
        try:
            stream = base64.b64decode(text.text(), validate=True)
        except (binascii.Error, ValueError):
            raise text.refused("text in base 64") from None
        none = np.zeros(0)
        begin = 0 if position is None else position.whole(0, _MAX_TICK)
        samples = block_samples(stream, length)
        blocks.append(Effect(begin, "Sine", none.astype(np.int64), none, none, samples))
    return blocks


def _basis(one: JsonValue) -> None:
    kind = one.at("effect_type").text(("Basis", "Composite", "Reference"))
    if kind != "Basis":
        raise one.wrong(f"an effect of type {kind}", "Basis", "Effect libraries and compositions are not read.")


def _effect(one: JsonValue) -> Effect:
    _basis(one)
    position, signal, phase = one.get("position"), one.get("base_signal"), one.get("phase")
    if phase is not None:
        phase.number(0, 6.2832)
    keyframes = one.get("keyframes")
    ticks, amplitudes, hertz = ([], [], []) if keyframes is None else _keyframes(keyframes)
    return Effect(
        0 if position is None else position.whole(0, _MAX_TICK),
        "Sine" if signal is None else signal.text(_SIGNALS),
        np.array(ticks, np.int64),
        np.array(amplitudes, np.float64),
        np.array(hertz, np.float64),
    )


def _keyframes(keyframes: JsonValue) -> tuple[list[int], list[float], list[float]]:
    """Ticks, amplitudes and frequencies; there are many of them, so that the usual case is checked in passing."""
    ticks: list[int] = []
    amplitudes: list[float] = []
    hertz: list[float] = []
    last = 0
    for i, one in enumerate(keyframes.items()):
        if not isinstance(one, Mapping):
            raise keyframes.item(i).refused("an object")
        tick = one.get("relative_position", 0)
        if type(tick) is not int or not last <= tick <= _MAX_TICK:
            raise _wrong_tick(keyframes.item(i), last)
        last = tick
        ticks.append(tick)
        amplitudes.append(_number(one, "amplitude_modulation", -1.0, 1.0, keyframes, i))
        hertz.append(_number(one, "frequency_modulation", 0.0, MAX_FREQUENCY_HZ, keyframes, i))
    return ticks, amplitudes, hertz


def _number(one: Mapping[str, Any], key: str, low: float, high: float, keyframes: JsonValue, index: int) -> float:
    found = one.get(key, np.nan)
    if type(found) is float and (low <= found <= high or found is np.nan):
        return found
    return keyframes.item(index).at(key).number(low, high)


def _wrong_tick(keyframe: JsonValue, last: int) -> Exception:
    where = keyframe.at("relative_position")
    where.whole(0, _MAX_TICK)
    return where.refused(f"a tick not before {last}, that of the keyframe before it")
