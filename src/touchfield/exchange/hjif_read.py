"""HJIF (ISO/IEC 23090-31) read into values: every member that is used is checked as the published schemas
have it.

The file comes from strangers: its length is bounded before it is read, whatever is made of it is bounded by
its bytes, and what breaks the schema is told in one line that names the place in the JSON.

**Blocks of wavelets** are 2^m samples of their band's upper frequency limit a second. A stream holds, least
bit of a byte first, the codes of an adaptive binary arithmetic coder of ten bits with a counter for each of
seven contexts; they are the number of bit planes (4), the greatest coefficient (1 + 7), and the bit planes of
the coefficients in the order of Said and Pearlman's set partitioning in hierarchical trees (1996). The
coefficients are those of a biorthogonal 9/7 wavelet over log2(n / 4) levels, symmetric at the ends.
"""

from __future__ import annotations

import base64
import binascii
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Float64s, Int64s
from touchfield.exchange.hmpg_read import BANDS, CURVES, KINDS, MODALITIES, read_hmpg
from touchfield.json_values import JsonValue, read_json
from touchfield.medium.medium import MAX_FREQUENCY_HZ

DEFAULT_TIMESCALE: Final = 1000
"""Ticks a second."""

MAX_TIMESCALE: Final = 48000
MAX_CHANNELS: Final = 65535

MAX_BYTES: Final = 1 << 26
_MAX_TICK: Final = (1 << 31) - 1
_MODALITIES: Final = (*MODALITIES, "Humidity", "User-defined Temporal", "User-defined Spatial")
LARGEST_VECTOR: Final = 127
_MAX_MASK: Final = (1 << 32) - 1
_MOST_SAMPLES: Final = 1 << 21
"""Of all wavelets of a file: four minutes at 8 kHz."""

MIN_BLOCK: Final = 16
MAX_BLOCK: Final = 4096
_FULL: Final = 1024
_HALF, _QUARTER, _THREE_QUARTERS = _FULL // 2, _FULL // 4, 3 * _FULL // 4
_DIGITS: Final = 10
_HEAD, _SIGN, _LONE, _SET, _CHILD, _GRANDCHILDREN, _REFINED = range(7)
_SMOOTH: Final = np.array([-0.064538882628938, -0.040689417609559, 0.418092273222212, 0.788485616405665])
_SHARP: Final = np.array(
    [-0.037828455506995, -0.023849465019380, 0.110624404418423, 0.377402855612654, -0.852698679009404]
)
"""The halves of the two symmetric filters of the synthesis, from their ends to their middle."""


@dataclass(frozen=True)
class Effect:
    """One effect of a band, from `position` on.

    The ticks of its keyframes count from there and never fall; amplitudes and frequencies [n] are NaN where a
    keyframe has none. A block of wavelets has samples instead, else none: so many of the band's upper limit a
    second.
    """

    position: int
    ticks: Int64s
    amplitudes: Float64s
    frequencies_hz: Float64s
    samples: Float64s


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

    `resolution` is (columns, rows) or None, `targets` are (column, row) from the lower left, and `body` names
    the body part, whatever way it is told.
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
class _Clock:
    """Ticks a second, and how many samples of wavelets there were so far."""

    timescale: int
    samples: int = 0


def read_hjif(path: str | Path) -> Hjif:
    """The perceptions of an ``.hjif`` file, or of its binary form ``.hmpg``.

    Raises SourceError if the file cannot be read, is longer than 64 MiB, is no JSON or breaks the schema; and
    where an effect refers to a library or is composed of others, or a curve is of a type that nobody draws
    alike.
    """
    is_binary = Path(path).suffix.lower() == ".hmpg"
    root = read_hmpg(path) if is_binary else read_json(path, MAX_BYTES, "an HJIF file")
    clock = _Clock(root.at("timescale", DEFAULT_TIMESCALE).whole(1, MAX_TIMESCALE))
    perceptions = tuple(_perception(one, clock) for one in root.at("perceptions").each(least=1))
    return Hjif(clock.timescale, perceptions, root)


def _perception(one: JsonValue, clock: _Clock) -> Perception:
    modality = one.at("perception_modality").text(_MODALITIES)
    names = [device.at("name").text() for device in one.at("reference_devices", []).each()]
    channels = one.at("channels")
    if len(channels.items(least=1)) > MAX_CHANNELS:
        raise channels.wrong(f"{len(channels.items())} channels", f"at most {MAX_CHANNELS}")
    return Perception(
        modality,
        one.at("perception_unit_exponent", 0).whole(-30, 30),
        names[0] if len(names) == 1 else "",
        tuple(_channel(channel, clock) for channel in channels.each()),
        one,
    )


def _channel(one: JsonValue, clock: _Clock) -> Channel:
    gain = one.at("gain").number(0) * one.at("mixing_coefficient").number(0)
    bits = one.at("body_part_mask", 0).whole(0, _MAX_MASK)
    body = tuple(part.text() for part in one.at("body_part_target", []).each())
    resolution, direction = one.get("actuator_resolution"), one.get("direction")
    size = None if resolution is None else _vector(resolution, 1)
    if resolution is not None and size is not None and size[2] != 1:
        raise resolution.wrong(f"an array {size[2]} actuators deep", "a flat one, Z of 1")
    return Channel(
        gain,
        None if size is None else size[:2],
        _targets(one.get("actuator_target"), size),
        body or ((f"mask {bits:#x}",) if bits else ()),
        None if direction is None else _vector(direction, -LARGEST_VECTOR),
        tuple(_band(band, clock) for band in one.at("bands").each()),
        one,
    )


def _targets(
    targets: JsonValue | None, size: tuple[int, int, int] | None
) -> tuple[tuple[int, int], ...] | None:
    if targets is None:
        return None
    places = []
    for target in targets.each():
        x, y, z = _vector(target, 0)
        if z or (size is not None and (x >= size[0] or y >= size[1])):
            within = "Z of 0" if size is None else f"a place within {size[0]} x {size[1]} x 1"
            raise target.wrong(f"the actuator ({x}, {y}, {z})", within)
        places.append((x, y))
    return tuple(places)


def _vector(one: JsonValue, low: int) -> tuple[int, int, int]:
    x, y, z = (one.at(key).whole(low, LARGEST_VECTOR) for key in ("X", "Y", "Z"))
    return x, y, z


def _band(one: JsonValue, clock: _Clock) -> Band:
    kind = one.at("band_type").text(BANDS)
    limits = [one.at(f"{end}_frequency_limit").number(0, MAX_FREQUENCY_HZ) for end in ("lower", "upper")]
    if limits[0] > limits[1]:
        raise one.wrong(f"limits of {limits[0]:g} and {limits[1]:g} Hz", "the lower one first")
    shape = one.at("curve_type", "Linear").text(CURVES)
    if kind == "Curve" and shape not in ("Linear", "Cubic", "Akima", "Unknown"):
        raise one.wrong(f"a curve of type {shape}", "Linear, Cubic or Akima")
    if kind == "WaveletWave":
        effects = _wavelets(one, limits[1], clock)
    else:
        effects = [_effect(effect) for effect in one.at("effects").each()]
    effects.sort(key=lambda effect: effect.position)
    return Band(kind, shape, limits[0], limits[1], tuple(effects), one)


def _wavelets(one: JsonValue, rate_hz: float, clock: _Clock) -> list[Effect]:
    """The blocks of a band of wavelets."""
    ticks = one.at("block_length").whole(1, _MAX_TICK)
    length = round(ticks * rate_hz / clock.timescale)
    if not MIN_BLOCK <= length <= MAX_BLOCK or length.bit_count() != 1:
        expected = f"a power of two from {MIN_BLOCK} to {MAX_BLOCK}"
        raise one.at("block_length").wrong(f"{ticks} ticks, {length} samples at {rate_hz:g} Hz", expected)
    effects = one.at("effects")
    clock.samples += len(effects.items()) * length
    if clock.samples > _MOST_SAMPLES:
        found = f"{len(effects.items())} blocks of {length} samples, {clock.samples} with those before"
        raise effects.wrong(found, f"at most {_MOST_SAMPLES}")
    blocks = []
    for effect in effects.each():
        _basis(effect)
        text = effect.at("wavelet_stream")
        try:
            stream = base64.b64decode(text.text(), validate=True)
        except (binascii.Error, ValueError):
            raise text.refused("text in base 64") from None
        none, begin = np.zeros(0), effect.at("position", 0).whole(0, _MAX_TICK)
        blocks.append(Effect(begin, none.astype(np.int64), none, none, block_samples(stream, length)))
    return blocks


def _basis(one: JsonValue) -> None:
    kind = one.at("effect_type").text(KINDS)
    if kind != "Basis":
        raise one.wrong(
            f"an effect of type {kind}", "Basis", "Effect libraries and compositions are not read."
        )


def _effect(one: JsonValue) -> Effect:
    _basis(one)
    begin = one.at("position", 0).whole(0, _MAX_TICK)
    before = 0
    ticks: list[int] = []
    amplitudes: list[float] = []
    hertz: list[float] = []
    for keyframe in one.at("keyframes", []).each():
        tick = keyframe.at("relative_position", 0)
        if tick.whole(0, _MAX_TICK) < before:
            raise tick.refused(f"a tick not before {before}, that of the keyframe before it")
        before = tick.value
        ticks.append(before)
        amplitude, frequency = keyframe.get("amplitude_modulation"), keyframe.get("frequency_modulation")
        amplitudes.append(math.nan if amplitude is None else amplitude.number(-1, 1))
        hertz.append(math.nan if frequency is None else frequency.number(0, MAX_FREQUENCY_HZ))
    return Effect(begin, np.array(ticks, np.int64), np.array(amplitudes), np.array(hertz), np.zeros(0))


class _Coder:
    """The decoded bits of a stream; behind its end come zeros."""

    def __init__(self, stream: bytes) -> None:
        self.bits = np.unpackbits(np.frombuffer(stream, np.uint8), bitorder="little").tolist()
        self.next, self.lead = 0, 0
        for _ in range(_DIGITS):
            self._take()
        self.low, self.high = 0, _FULL
        self.zeros, self.seen = [8] * 7, [16] * 7

    def _take(self) -> None:
        bit = self.bits[self.next] if self.next < len(self.bits) else 0
        self.lead, self.next = 2 * self.lead + bit, self.next + 1

    def bit(self, context: int) -> int:
        width = self.high - self.low
        share = int(self.zeros[context] / self.seen[context] * _FULL + 0.5)
        split = min(max(width * share // _FULL, 1), width - 1)
        bit = int(self.lead - self.low >= split)
        if bit:
            self.low += split
        else:
            self.high = self.low + split
            self.zeros[context] += 1
        self.seen[context] += 1
        while True:
            if self.high <= _HALF:
                off = 0
            elif self.low >= _HALF:
                off = _HALF
            elif self.low >= _QUARTER and self.high <= _THREE_QUARTERS:
                off = _QUARTER
            else:
                return bit
            self.low, self.high = 2 * (self.low - off), 2 * (self.high - off)
            self.lead -= off
            self._take()

    def number(self, count: int) -> int:
        return sum(self.bit(_HEAD) << i for i in range(count))


def block_samples(stream: bytes, length: int) -> Float64s:
    """The samples of a block, float64 [length].

    Parameters
    ----------
    stream : bytes
        As the file has it; an empty one is silence.
    length : int
        A power of two from 16 to 4096.
    """
    if not stream:
        return np.zeros(length)
    bits = _Coder(stream)
    planes = bits.number(4)
    has_integer = bits.bit(_HEAD)
    mantissa = bits.number(7)
    greatest = 1 + mantissa / 8 if has_integer else mantissa / 128
    coefficients = np.array(_coefficients(bits, length, planes), np.float64)
    return _synthesis(coefficients * (greatest / 2.0**planes))


def _coefficients(bits: _Coder, length: int, planes: int) -> list[int]:
    """Coefficients in whole steps of the last bit plane, by set partitioning."""
    out = [0] * length
    known: list[int] = []
    lone = list(range(8))
    sets = [(at, False) for at in range(4, 8)]
    for plane in range(planes, -1, -1):
        step, before = 1 << plane, len(known)
        places, lone = lone, []
        for at in places:
            _look(bits, _LONE, at, step, out, known, lone)
        walked, sets = sets, []
        for at, is_deep in walked:  # grows while it is walked
            if not bits.bit(_GRANDCHILDREN if is_deep else _SET):
                sets.append((at, is_deep))
            elif is_deep:
                walked += [(2 * at, False), (2 * at + 1, False)]
            else:
                for child in (2 * at, 2 * at + 1):
                    _look(bits, _CHILD, child, step, out, known, lone)
                if 4 * at + 3 < length:
                    walked.append((at, True))
        for at in known[:before]:
            if bits.bit(_REFINED):
                out[at] += step if out[at] > 0 else -step
    return out


def _look(
    bits: _Coder, context: int, at: int, step: int, out: list[int], known: list[int], lone: list[int]
) -> None:
    """Read one coefficient's bit of this plane: once it is set, the sign is known; else it is looked at
    again.
    """
    if bits.bit(context):
        out[at] = step if bits.bit(_SIGN) else -step
        known.append(at)
    else:
        lone.append(at)


def _synthesis(coefficients: Float64s) -> Float64s:
    samples = coefficients.copy()
    for level in range(int(np.log2(len(samples) / 4)) - 1, -1, -1):
        length = len(samples) >> level
        low, high = np.zeros(length), np.zeros(length)
        low[::2], high[1::2] = samples[: length // 2], samples[length // 2 : length]
        samples[:length] = _filtered(low, _SMOOTH) + _filtered(high, _SHARP)
    return samples


def _filtered(values: Float64s, half: Float64s) -> Float64s:
    reach = len(half) - 1
    both = np.concatenate([half, half[-2::-1]])
    filtered: Float64s = np.convolve(np.pad(values, reach, "reflect"), both, "valid")
    return filtered
