"""Reads ``.hmpg``, the binary format of MPEG haptics (ISO/IEC 23090-31).

It returns the equivalent document of HJIF. A file consists of units, each with a head of nine bytes (type 6
bits, sync 2, layer 4, duration 24, length 32, reserved 4) and packets, each with a head of three (type 6,
length 17, reserved 1). Packets contain the timescale, perceptions, channels and bands; a packet of data
contains effects of one band, whose positions count from the start of its unit, and an effect that continues
in another unit keeps its number. Checksums are ignored, as by default in the reference decoder.

All memory is bounded by the size of the file, since every item that is counted takes some of its bytes.
"""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any, Final

from touchfield.errors import SourceError
from touchfield.files import read_bytes
from touchfield.json_values import JsonValue

_DESCRIPTION: Final = "an HMPG file (ISO/IEC 23090-31, binary)"
_MAX_BYTES: Final = 1 << 22
_UNIT_HEAD: Final = 9
_PACKET_HEAD: Final = 3
_TIMING, _, _PERCEPTION, _CHANNEL, _BAND, _DATA, _LIBRARY = range(7)
_INITIAL_TIMING: Final = 11
MODALITIES: Final = (
    "Other", "Pressure", "Acceleration", "Velocity", "Position", "Temperature", "Vibrotactile", "Water",
    "Wind", "Force", "Vibrotactile Texture", "Stiffness", "Friction", "Electrotactile",
)  # fmt: skip
"""Names of HJIF in the order of their numbers in the binary form; so are the tables below."""

BANDS: Final = ("Transient", "Curve", "VectorialWave", "WaveletWave")
CURVES: Final = ("Unknown", "Cubic", "Linear", "Akima", "Bezier", "BSpline")
KINDS: Final = ("Basis", "Reference", "Composite")
_SPATIAL: Final = 2
_MAX_VALUE: Final = 10000.0


class _Bits:
    """Bits of a packet, most significant first; SourceError if there are too few."""

    def __init__(self, data: bytes, where: str) -> None:
        self.data, self.at, self.where = data, 0, where

    def unsigned(self, count: int) -> int:
        end = self.at + count
        remaining = 8 * len(self.data) - self.at
        if count > remaining:
            raise SourceError(
                self.where, f"{remaining} bits left", f"{count} more", "The file is cut or damaged."
            )
        value = int.from_bytes(self.data[self.at >> 3 : (end + 7) >> 3], "big") >> (-end % 8)
        self.at = end
        return value & ((1 << count) - 1)

    def signed(self, count: int) -> int:
        value = self.unsigned(count)
        return value - (1 << count) if value >> (count - 1) else value

    def number(self, count: int, low: float, high: float) -> float:
        return low + (high - low) * self.unsigned(count) / ((1 << count) - 1)

    def text(self) -> str:
        return bytes(self.unsigned(8) for _ in range(self.unsigned(8))).decode("utf-8", "replace")

    def choice(self, count: int, names: tuple[str, ...], description: str) -> str:
        value = self.unsigned(count)
        if value >= len(names):
            raise SourceError(self.where, f"{description} {value}", f"0 to {len(names) - 1}")
        return names[value]

    def vector(self) -> dict[str, int]:
        return {axis: self.signed(8) for axis in "XYZ"}


class _Document:
    """The document, from the packets read so far."""

    def __init__(self) -> None:
        self.timescale, self.time, self.is_spatial = 1000, 0, False
        self.perceptions: dict[int, dict[str, Any]] = {}
        self.channels: dict[tuple[int, int], dict[str, Any]] = {}
        self.bands: dict[int, dict[str, Any]] = {}
        self.effects: dict[tuple[int, int], dict[str, Any]] = {}


def read_hmpg(path: str | Path) -> JsonValue:
    """Read an ``.hmpg`` file as a document in the form of HJIF.

    Raises SourceError if the file cannot be read, is longer than 4 MiB, is truncated, or refers to something
    that was not defined before.
    """
    data = read_bytes(path, _MAX_BYTES, _DESCRIPTION)
    document, at, unit = _Document(), 0, 0
    while at < len(data):
        head = _Bits(data[at : at + _UNIT_HEAD], f"{path}: unit {unit}")
        kind, _, _, duration, length, _ = (head.unsigned(n) for n in (6, 2, 4, 24, 32, 4))
        if length > len(data) - at - _UNIT_HEAD:
            found = f"{len(data) - at - _UNIT_HEAD} bytes left"
            raise SourceError(
                head.where, found, f"the {length} of its length", f"It should be {_DESCRIPTION}."
            )
        start = at + _UNIT_HEAD
        document.is_spatial = kind == _SPATIAL
        _unit(document, data[start : start + length], f"{path}: unit {unit}")
        at, unit = start + length, unit + 1
        document.time += duration
    if not document.perceptions:
        raise SourceError(str(path), "no perception", _DESCRIPTION)
    perceptions = list(document.perceptions.values())
    return JsonValue({"timescale": document.timescale, "perceptions": perceptions}, str(path))


def _unit(document: _Document, data: bytes, where: str) -> None:
    at = 0
    while at < len(data):
        head = _Bits(data[at : at + _PACKET_HEAD], f"{where}, byte {at}")
        kind, length, _ = (head.unsigned(n) for n in (6, 17, 1))
        at += _PACKET_HEAD
        if length > len(data) - at:
            raise SourceError(
                head.where, f"{len(data) - at} bytes left", f"the {length} of the packet's length"
            )
        bits = _Bits(data[at : at + length], f"{head.where}, packet of type {kind}")
        if kind in _READERS:
            _READERS[kind](document, bits)
        elif kind == _LIBRARY and length > _PACKET_HEAD:
            raise SourceError(bits.where, "a library of effects", "effects of their own")
        at += length


def _initial_timing(document: _Document, bits: _Bits) -> None:
    document.time, document.timescale = bits.unsigned(32), bits.unsigned(32)


def _timing(document: _Document, bits: _Bits) -> None:
    document.time = bits.unsigned(32)


def _perception(document: _Document, bits: _Bits) -> None:
    number, _, _ = bits.unsigned(8), bits.unsigned(8), bits.text()
    modality = bits.choice(8, MODALITIES, "a modality of number")
    bits.unsigned(8 + 16)  # its avatar, and effects of the library
    if bits.unsigned(1):
        bits.text()
    bits.signed(8)
    exponent = bits.signed(8)
    devices = [_device(bits) for _ in range(bits.unsigned(8))]
    perception = document.perceptions.setdefault(number, {"channels": []})
    perception.update(
        perception_modality=modality, perception_unit_exponent=exponent, reference_devices=devices
    )


def _device(bits: _Bits) -> dict[str, Any]:
    _, name = bits.unsigned(8), bits.text()
    bits.unsigned(32)  # body parts
    flags = bits.unsigned(12)
    bits.unsigned(32 * (flags >> 1).bit_count() + 4 * (flags & 1))  # not used
    return {"name": name}


def _channel(document: _Document, bits: _Bits) -> None:
    number, perception = bits.unsigned(16), bits.unsigned(8)
    bits.unsigned(8)  # priority
    bits.text()
    bits.unsigned(8)  # its device
    fields: dict[str, Any] = {}
    fields["gain"] = max(0.0, round(bits.number(32, -_MAX_VALUE, _MAX_VALUE), 5))
    fields["mixing_coefficient"] = round(bits.number(32, 0, _MAX_VALUE), 5)
    flags = bits.unsigned(8)
    if flags & 1:
        fields["body_part_mask"] = bits.unsigned(32)
    elif flags & 2:
        fields["actuator_resolution"] = bits.vector()
        fields["body_part_target"] = [f"part {bits.unsigned(8)}" for _ in range(bits.unsigned(8))]
        fields["actuator_target"] = [bits.vector() for _ in range(bits.unsigned(8))]
    if bits.unsigned(32):
        bits.unsigned(32)
    if flags & 4:
        fields["direction"] = bits.vector()
    if perception not in document.perceptions:
        found = f"a channel of perception {perception}"
        raise SourceError(bits.where, found, "one that an earlier unit declared")
    channel = document.channels.get((perception, number))
    if channel is None:
        channel = document.channels[perception, number] = {"bands": []}
        document.perceptions[perception]["channels"].append(channel)
    channel.update(fields)


def _band(document: _Document, bits: _Bits) -> None:
    number, perception, channel = bits.unsigned(8), bits.unsigned(8), bits.unsigned(16)
    bits.unsigned(8)  # priority
    fields: dict[str, Any] = {"band_type": bits.choice(3, BANDS, "a band of type")}
    if fields["band_type"] == "Curve":
        fields["curve_type"] = bits.choice(4, CURVES, "a curve of type")
    elif fields["band_type"] == "WaveletWave":
        fields["block_length"] = bits.unsigned(8)
    fields["lower_frequency_limit"], fields["upper_frequency_limit"] = bits.unsigned(16), bits.unsigned(16)
    if (perception, channel) not in document.channels:
        raise SourceError(bits.where, f"a band of channel {channel}", "one that an earlier unit declared")
    if number not in document.bands:
        document.bands[number] = {"effects": []}
        document.channels[perception, channel]["bands"].append(document.bands[number])
    document.bands[number].update(fields)


def _data(document: _Document, bits: _Bits) -> None:
    bits.unsigned(1 + 8 + 16)  # kind of access; perception and channel, which the band knows
    number = bits.unsigned(8)
    if number not in document.bands:
        raise SourceError(bits.where, f"effects of band {number}", "a band that an earlier unit declared")
    band = document.bands[number]
    for _ in range(bits.unsigned(16)):
        name = (number, bits.unsigned(16))
        fields: dict[str, Any] = {"effect_type": bits.choice(2, KINDS, "an effect of type")}
        if band["band_type"] == "WaveletWave":
            _semantic(bits)
            fields["position"] = len(band["effects"]) * band["block_length"]
            fields["wavelet_stream"] = base64.b64encode(
                bytes(bits.unsigned(8) for _ in range(bits.unsigned(16)))
            ).decode()
            band["effects"].append(fields)
            return  # a packet contains one block
        fields["position"] = bits.signed(25) + (0 if document.is_spatial else document.time)
        if fields["effect_type"] == "Basis":
            _semantic(bits)
            fields["keyframes"] = _keyframes(bits, band["band_type"])
        effect = document.effects.get(name)
        if effect is None or fields["effect_type"] != "Basis":
            document.effects[name] = fields
            band["effects"].append(fields)
        elif effect["effect_type"] != "Basis":
            raise SourceError(bits.where, f"key frames of effect {name[1]}", "an effect that has key frames")
        else:
            effect["keyframes"] += fields["keyframes"]


def _semantic(bits: _Bits) -> None:
    if bits.unsigned(1):
        bits.unsigned(12)


def _keyframes(bits: _Bits, kind: str) -> list[dict[str, Any]]:
    count, keyframes = bits.unsigned(16), []
    is_wave = kind == "VectorialWave"
    if is_wave:
        bits.unsigned(16 + 4)  # phase and base signal
    for _ in range(count):
        flags = bits.unsigned(2) if is_wave else 1 if kind == "Curve" else 3
        keyframe: dict[str, Any] = {}
        if flags & 1:
            keyframe["amplitude_modulation"] = bits.number(8, -1, 1)
        keyframe["relative_position"] = bits.unsigned(16)
        if flags & 2:
            keyframe["frequency_modulation"] = float(min(bits.unsigned(16), _MAX_VALUE))
        keyframes.append(keyframe)
    return keyframes


_READERS: Final = {
    _TIMING: _timing, _PERCEPTION: _perception, _CHANNEL: _channel, _BAND: _band,
    _DATA: _data, _INITIAL_TIMING: _initial_timing,
}  # fmt: skip
