"""Reads HJIF, the JSON format of MPEG haptics (ISO/IEC 23090-31), and checks every member that it uses.

The checks are those of the published schemas. The file is untrusted: its length is bounded before it is read,
all memory is bounded by its size, and a violation of the schema is reported in one line with its position in
the JSON.

**Blocks of wavelets** are 2^m samples, at a rate of their band's upper frequency limit. A stream contains the
output of an adaptive binary arithmetic coder with a precision of ten bits and a counter for each of seven
contexts; the least significant bit of a byte comes first. The coded bits are the number of bit planes (4
bits), the largest coefficient (1 + 7 bits), and the bit planes of the coefficients in the order of set
partitioning in hierarchical trees (SPIHT; Said and Pearlman, 1996). The coefficients are those of a
biorthogonal 9/7 wavelet over log2(n / 4) levels, symmetric at the ends.
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
MAX_VECTOR: Final = 127
_MAX_MASK: Final = (1 << 32) - 1
_MAX_SAMPLES: Final = 1 << 21
"""Limit for all wavelets of a file: four minutes at 8 kHz."""

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
"""Halves of the two symmetric synthesis filters, from their ends to their middle."""


@dataclass(frozen=True)
class Effect:
    """One effect of a band, starting at `position`.

    The ticks of its keyframes count from there and never decrease; amplitudes and frequencies [n] are NaN
    where a keyframe has none. A block of wavelets has samples instead, at a rate of the band's upper limit;
    other effects have none.
    """

    position: int
    ticks: Int64s
    amplitudes: Float64s
    frequencies_hz: Float64s
    samples: Float64s


@dataclass(frozen=True)
class Band:
    """One band of a channel; `effects` are sorted by position."""

    kind: str
    curve: str
    lower_hz: float
    upper_hz: float
    effects: tuple[Effect, ...]
    node: JsonValue


@dataclass(frozen=True)
class Channel:
    """One channel.

    `resolution` is (columns, rows) or None, `targets` are (column, row) from the lower left, and `body` names
    the body part, in whichever form the file has it.
    """

    gain: float
    resolution: tuple[int, int] | None
    targets: tuple[tuple[int, int], ...] | None
    body: tuple[str, ...]
    direction: tuple[int, int, int] | None
    bands: tuple[Band, ...]
    node: JsonValue


@dataclass(frozen=True)
class Perception:
    """One perception: modality, power of ten of its unit, reference device and channels."""

    modality: str
    unit_exponent: int
    device_name: str
    channels: tuple[Channel, ...]
    node: JsonValue


@dataclass(frozen=True)
class Hjif:
    """A whole file: ticks a second, and perceptions."""

    timescale: int
    perceptions: tuple[Perception, ...]
    node: JsonValue


@dataclass
class _Clock:
    """Ticks a second, and the number of wavelet samples so far."""

    timescale: int
    samples: int = 0


def read_hjif(path: str | Path) -> Hjif:
    """Read an ``.hjif`` file, or its binary form ``.hmpg``.

    Raises SourceError if the file cannot be read, is longer than 64 MiB, is not JSON or violates the schema;
    and if an effect refers to a library or is composed of others, or a curve is of a type without an agreed
    definition.
    """
    is_binary = Path(path).suffix.lower() == ".hmpg"
    root = read_hmpg(path) if is_binary else read_json(path, MAX_BYTES, "an HJIF file")
    clock = _Clock(root.at("timescale", DEFAULT_TIMESCALE).bounded_integer(1, MAX_TIMESCALE))
    perceptions = tuple(_perception(entry, clock) for entry in root.at("perceptions").elements(min_count=1))
    return Hjif(clock.timescale, perceptions, root)


def _perception(entry: JsonValue, clock: _Clock) -> Perception:
    modality = entry.at("perception_modality").text(_MODALITIES)
    names = [device.at("name").text() for device in entry.at("reference_devices", []).elements()]
    channels = entry.at("channels")
    if len(channels.items(min_count=1)) > MAX_CHANNELS:
        raise channels.wrong(f"{len(channels.items())} channels", f"at most {MAX_CHANNELS}")
    return Perception(
        modality,
        entry.at("perception_unit_exponent", 0).bounded_integer(-30, 30),
        names[0] if len(names) == 1 else "",
        tuple(_channel(channel, clock) for channel in channels.elements()),
        entry,
    )


def _channel(entry: JsonValue, clock: _Clock) -> Channel:
    gain = entry.at("gain").number(0) * entry.at("mixing_coefficient").number(0)
    bits = entry.at("body_part_mask", 0).bounded_integer(0, _MAX_MASK)
    body = tuple(part.text() for part in entry.at("body_part_target", []).elements())
    resolution, direction = entry.get("actuator_resolution"), entry.get("direction")
    size = None if resolution is None else _vector(resolution, 1)
    if resolution is not None and size is not None and size[2] != 1:
        raise resolution.wrong(f"an array {size[2]} actuators deep", "a flat one, Z of 1")
    return Channel(
        gain,
        None if size is None else size[:2],
        _targets(entry.get("actuator_target"), size),
        body or ((f"mask {bits:#x}",) if bits else ()),
        None if direction is None else _vector(direction, -MAX_VECTOR),
        tuple(_band(band, clock) for band in entry.at("bands").elements()),
        entry,
    )


def _targets(
    targets: JsonValue | None, size: tuple[int, int, int] | None
) -> tuple[tuple[int, int], ...] | None:
    if targets is None:
        return None
    positions = []
    for target in targets.elements():
        x, y, z = _vector(target, 0)
        if z or (size is not None and (x >= size[0] or y >= size[1])):
            within = "Z of 0" if size is None else f"a place within {size[0]} x {size[1]} x 1"
            raise target.wrong(f"the actuator ({x}, {y}, {z})", within)
        positions.append((x, y))
    return tuple(positions)


def _vector(entry: JsonValue, low: int) -> tuple[int, int, int]:
    x, y, z = (entry.at(key).bounded_integer(low, MAX_VECTOR) for key in ("X", "Y", "Z"))
    return x, y, z


def _band(entry: JsonValue, clock: _Clock) -> Band:
    kind = entry.at("band_type").text(BANDS)
    limits = [entry.at(f"{end}_frequency_limit").number(0, MAX_FREQUENCY_HZ) for end in ("lower", "upper")]
    if limits[0] > limits[1]:
        raise entry.wrong(f"limits of {limits[0]:g} and {limits[1]:g} Hz", "the lower one first")
    shape = entry.at("curve_type", "Linear").text(CURVES)
    if kind == "Curve" and shape not in ("Linear", "Cubic", "Akima", "Unknown"):
        raise entry.wrong(f"a curve of type {shape}", "Linear, Cubic or Akima")
    if kind == "WaveletWave":
        effects = _wavelets(entry, limits[1], clock)
    else:
        effects = [_effect(effect) for effect in entry.at("effects").elements()]
    effects.sort(key=lambda effect: effect.position)
    return Band(kind, shape, limits[0], limits[1], tuple(effects), entry)


def _wavelets(entry: JsonValue, rate_hz: float, clock: _Clock) -> list[Effect]:
    """Read the blocks of a band of wavelets."""
    ticks = entry.at("block_length").bounded_integer(1, _MAX_TICK)
    length = round(ticks * rate_hz / clock.timescale)
    if not MIN_BLOCK <= length <= MAX_BLOCK or length.bit_count() != 1:
        expected = f"a power of two from {MIN_BLOCK} to {MAX_BLOCK}"
        raise entry.at("block_length").wrong(f"{ticks} ticks, {length} samples at {rate_hz:g} Hz", expected)
    effects = entry.at("effects")
    clock.samples += len(effects.items()) * length
    if clock.samples > _MAX_SAMPLES:
        found = f"{len(effects.items())} blocks of {length} samples, {clock.samples} with those before"
        raise effects.wrong(found, f"at most {_MAX_SAMPLES}")
    blocks = []
    for effect in effects.elements():
        _require_basis(effect)
        text = effect.at("wavelet_stream")
        try:
            stream = base64.b64decode(text.text(), validate=True)
        except (binascii.Error, ValueError):
            raise text.refused("text in base 64") from None
        none, start = np.zeros(0), effect.at("position", 0).bounded_integer(0, _MAX_TICK)
        blocks.append(Effect(start, none.astype(np.int64), none, none, block_samples(stream, length)))
    return blocks


def _require_basis(entry: JsonValue) -> None:
    kind = entry.at("effect_type").text(KINDS)
    if kind != "Basis":
        raise entry.wrong(
            f"an effect of type {kind}", "Basis", "Effect libraries and compositions are not read."
        )


def _effect(entry: JsonValue) -> Effect:
    _require_basis(entry)
    start = entry.at("position", 0).bounded_integer(0, _MAX_TICK)
    before = 0
    ticks: list[int] = []
    amplitudes: list[float] = []
    hertz: list[float] = []
    for keyframe in entry.at("keyframes", []).elements():
        tick = keyframe.at("relative_position", 0)
        if tick.bounded_integer(0, _MAX_TICK) < before:
            raise tick.refused(f"a tick not before {before}, that of the keyframe before it")
        before = tick.value
        ticks.append(before)
        amplitude, frequency = keyframe.get("amplitude_modulation"), keyframe.get("frequency_modulation")
        amplitudes.append(math.nan if amplitude is None else amplitude.number(-1, 1))
        hertz.append(math.nan if frequency is None else frequency.number(0, MAX_FREQUENCY_HZ))
    return Effect(start, np.array(ticks, np.int64), np.array(amplitudes), np.array(hertz), np.zeros(0))


class _ArithmeticDecoder:
    """Arithmetic decoder of a stream; zeros follow its end."""

    def __init__(self, stream: bytes) -> None:
        self.bits = np.unpackbits(np.frombuffer(stream, np.uint8), bitorder="little").tolist()
        self.next, self.lead = 0, 0
        for _ in range(_DIGITS):
            self._take()
        self.low, self.high = 0, _FULL
        self.zeros, self.totals = [8] * 7, [16] * 7

    def _take(self) -> None:
        bit = self.bits[self.next] if self.next < len(self.bits) else 0
        self.lead, self.next = 2 * self.lead + bit, self.next + 1

    def bit(self, context: int) -> int:
        width = self.high - self.low
        zero_width = int(self.zeros[context] / self.totals[context] * _FULL + 0.5)
        split = min(max(width * zero_width // _FULL, 1), width - 1)
        bit = int(self.lead - self.low >= split)
        if bit:
            self.low += split
        else:
            self.high = self.low + split
            self.zeros[context] += 1
        self.totals[context] += 1
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
    """Decode the samples of a block of wavelets, float64 [length].

    Parameters
    ----------
    stream : bytes
        As in the file; an empty stream is silence.
    length : int
        A power of two from 16 to 4096.
    """
    if not stream:
        return np.zeros(length)
    bits = _ArithmeticDecoder(stream)
    planes = bits.number(4)
    has_integer = bits.bit(_HEAD)
    mantissa = bits.number(7)
    greatest = 1 + mantissa / 8 if has_integer else mantissa / 128
    coefficients = np.array(_coefficients(bits, length, planes), np.float64)
    return _synthesis(coefficients * (greatest / 2.0**planes))


def _coefficients(bits: _ArithmeticDecoder, length: int, planes: int) -> list[int]:
    """Read the coefficients, in steps of the last bit plane, by set partitioning."""
    out = [0] * length
    significant: list[int] = []
    insignificant = list(range(8))
    sets = [(at, False) for at in range(4, 8)]
    for plane in range(planes, -1, -1):
        step, before = 1 << plane, len(significant)
        tested, insignificant = insignificant, []
        for at in tested:
            _read_significance(bits, _LONE, at, step, out, significant, insignificant)
        walked, sets = sets, []
        for at, is_deep in walked:  # grows while it is walked
            if not bits.bit(_GRANDCHILDREN if is_deep else _SET):
                sets.append((at, is_deep))
            elif is_deep:
                walked += [(2 * at, False), (2 * at + 1, False)]
            else:
                for child in (2 * at, 2 * at + 1):
                    _read_significance(bits, _CHILD, child, step, out, significant, insignificant)
                if 4 * at + 3 < length:
                    walked.append((at, True))
        for at in significant[:before]:
            if bits.bit(_REFINED):
                out[at] += step if out[at] > 0 else -step
    return out


def _read_significance(
    bits: _ArithmeticDecoder,
    context: int,
    at: int,
    step: int,
    out: list[int],
    significant: list[int],
    insignificant: list[int],
) -> None:
    """Read a coefficient's bit of this plane, and its sign if the bit is set.

    If it is not set, the coefficient is tested again in the next plane.
    """
    if bits.bit(context):
        out[at] = step if bits.bit(_SIGN) else -step
        significant.append(at)
    else:
        insignificant.append(at)


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
