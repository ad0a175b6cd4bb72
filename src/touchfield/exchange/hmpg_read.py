"""The binary form of MPEG haptics (ISO/IEC 23090-31), ``.hmpg``, read as the document that HJIF would be.

A file is units, each a head of nine bytes (type 6 bits, sync 2, layer 4, duration 24, length 32, reserved 4)
and packets, each a head of three (type 6, length 17, reserved 1). Packets tell the timescale, perceptions,
channels and bands; a packet of data holds effects of one band, whose positions count from the beginning of
its unit, and an effect that goes on in another unit keeps its number. Checksums are passed over, as the
reference decoder's default is.

Everything is bounded by the bytes of the file: each thing that is counted takes some of them.
"""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any, Final

from touchfield.errors import SourceError
from touchfield.files import read_bytes
from touchfield.json_values import JsonValue

_WHAT: Final = "an HMPG file (ISO/IEC 23090-31, binary)"
_MOST_BYTES: Final = 1 << 22
_UNIT_HEAD: Final = 9
_PACKET_HEAD: Final = 3
_TIMING, _, _PERCEPTION, _CHANNEL, _BAND, _DATA, _LIBRARY = range(7)
_INITIAL_TIMING: Final = 11
MODALITIES: Final = (
    "Other", "Pressure", "Acceleration", "Velocity", "Position", "Temperature", "Vibrotactile", "Water", "Wind",
    "Force", "Vibrotactile Texture", "Stiffness", "Friction", "Electrotactile",
)  # fmt: skip
"""Words of HJIF in the order of the binary form's numbers, as the tables below."""

BANDS: Final = ("Transient", "Curve", "VectorialWave", "WaveletWave")
CURVES: Final = ("Unknown", "Cubic", "Linear", "Akima", "Bezier", "BSpline")
KINDS: Final = ("Basis", "Reference", "Composite")
_SPATIAL: Final = 2
_GREATEST: Final = 10000.0


class _Bits:
    """Bits of a packet, most significant first; SourceError where there are too few."""

    def __init__(self, data: bytes, where: str) -> None:
        self.data, self.at, self.where = data, 0, where

    def whole(self, count: int) -> int:
        end = self.at + count
        left = 8 * len(self.data) - self.at
        if count > left:
            raise SourceError(self.where, f"{left} bits left", f"{count} more", "The file is cut or damaged.")
        value = int.from_bytes(self.data[self.at >> 3 : (end + 7) >> 3], "big") >> (-end % 8)
        self.at = end
        return value & ((1 << count) - 1)

    def signed(self, count: int) -> int:
        value = self.whole(count)
        return value - (1 << count) if value >> (count - 1) else value

    def number(self, count: int, low: float, high: float) -> float:
        return low + (high - low) * self.whole(count) / ((1 << count) - 1)

    def text(self) -> str:
        return bytes(self.whole(8) for _ in range(self.whole(8))).decode("utf-8", "replace")

    def one_of(self, count: int, names: tuple[str, ...], what: str) -> str:
        value = self.whole(count)
        if value >= len(names):
            raise SourceError(self.where, f"{what} {value}", f"0 to {len(names) - 1}")
        return names[value]

    def vector(self) -> dict[str, int]:
        return {axis: self.signed(8) for axis in "XYZ"}


class _Document:
    """The document as far as the packets have come."""

    def __init__(self) -> None:
        self.timescale, self.time, self.is_spatial = 1000, 0, False
        self.perceptions: dict[int, dict[str, Any]] = {}
        self.channels: dict[tuple[int, int], dict[str, Any]] = {}
        self.bands: dict[int, dict[str, Any]] = {}
        self.effects: dict[tuple[int, int], dict[str, Any]] = {}


def read_hmpg(path: str | Path) -> JsonValue:
    """The document in a ``.hmpg`` file, in the words of HJIF.

    Raises SourceError if the file cannot be read, is longer than 4 MiB, ends within something, or refers to
    what it has not told.
    """
    data = read_bytes(path, _MOST_BYTES, _WHAT)
    document, at, unit = _Document(), 0, 0
    while at < len(data):
        head = _Bits(data[at : at + _UNIT_HEAD], f"{path}: unit {unit}")
        kind, _, _, duration, length, _ = (head.whole(n) for n in (6, 2, 4, 24, 32, 4))
        if length > len(data) - at - _UNIT_HEAD:
            found = f"{len(data) - at - _UNIT_HEAD} bytes left"
            raise SourceError(head.where, found, f"the {length} of its length", f"It should be {_WHAT}.")
        begin = at + _UNIT_HEAD
        document.is_spatial = kind == _SPATIAL
        _unit(document, data[begin : begin + length], f"{path}: unit {unit}")
        at, unit = begin + length, unit + 1
        document.time += duration
    if not document.perceptions:
        raise SourceError(str(path), "no perception", _WHAT)
    perceptions = list(document.perceptions.values())
    return JsonValue({"timescale": document.timescale, "perceptions": perceptions}, str(path))


def _unit(document: _Document, data: bytes, where: str) -> None:
    at = 0
    while at < len(data):
        head = _Bits(data[at : at + _PACKET_HEAD], f"{where}, byte {at}")
        kind, length, _ = (head.whole(n) for n in (6, 17, 1))
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
    document.time, document.timescale = bits.whole(32), bits.whole(32)


def _timing(document: _Document, bits: _Bits) -> None:
    document.time = bits.whole(32)


def _perception(document: _Document, bits: _Bits) -> None:
    number, _, _ = bits.whole(8), bits.whole(8), bits.text()
    modality = bits.one_of(8, MODALITIES, "a modality of number")
    bits.whole(8 + 16)  # its avatar, and effects of the library
    if bits.whole(1):
        bits.text()
    bits.signed(8)
    exponent = bits.signed(8)
    devices = [_device(bits) for _ in range(bits.whole(8))]
    known = document.perceptions.setdefault(number, {"channels": []})
    known.update(perception_modality=modality, perception_unit_exponent=exponent, reference_devices=devices)


def _device(bits: _Bits) -> dict[str, Any]:
    _, name = bits.whole(8), bits.text()
    bits.whole(32)  # body parts
    flags = bits.whole(12)
    bits.whole(32 * (flags >> 1).bit_count() + 4 * (flags & 1))  # none of which we use
    return {"name": name}


def _channel(document: _Document, bits: _Bits) -> None:
    number, perception = bits.whole(16), bits.whole(8)
    bits.whole(8)  # priority
    bits.text()
    bits.whole(8)  # its device
    own: dict[str, Any] = {}
    own["gain"] = max(0.0, round(bits.number(32, -_GREATEST, _GREATEST), 5))
    own["mixing_coefficient"] = round(bits.number(32, 0, _GREATEST), 5)
    flags = bits.whole(8)
    if flags & 1:
        own["body_part_mask"] = bits.whole(32)
    elif flags & 2:
        own["actuator_resolution"] = bits.vector()
        own["body_part_target"] = [f"part {bits.whole(8)}" for _ in range(bits.whole(8))]
        own["actuator_target"] = [bits.vector() for _ in range(bits.whole(8))]
    if bits.whole(32):
        bits.whole(32)
    if flags & 4:
        own["direction"] = bits.vector()
    if perception not in document.perceptions:
        raise SourceError(bits.where, f"a channel of perception {perception}", "one that was told before it")
    known = document.channels.get((perception, number))
    if known is None:
        known = document.channels[perception, number] = {"bands": []}
        document.perceptions[perception]["channels"].append(known)
    known.update(own)


def _band(document: _Document, bits: _Bits) -> None:
    number, perception, channel = bits.whole(8), bits.whole(8), bits.whole(16)
    bits.whole(8)  # priority
    own: dict[str, Any] = {"band_type": bits.one_of(3, BANDS, "a band of type")}
    if own["band_type"] == "Curve":
        own["curve_type"] = bits.one_of(4, CURVES, "a curve of type")
    elif own["band_type"] == "WaveletWave":
        own["block_length"] = bits.whole(8)
    own["lower_frequency_limit"], own["upper_frequency_limit"] = bits.whole(16), bits.whole(16)
    if (perception, channel) not in document.channels:
        raise SourceError(bits.where, f"a band of channel {channel}", "one that was told before it")
    if number not in document.bands:
        document.bands[number] = {"effects": []}
        document.channels[perception, channel]["bands"].append(document.bands[number])
    document.bands[number].update(own)


def _data(document: _Document, bits: _Bits) -> None:
    bits.whole(1 + 8 + 16)  # kind of access; perception and channel, which the band knows
    number = bits.whole(8)
    if number not in document.bands:
        raise SourceError(bits.where, f"effects of band {number}", "a band that was told before them")
    band = document.bands[number]
    for _ in range(bits.whole(16)):
        name = (number, bits.whole(16))
        own: dict[str, Any] = {"effect_type": bits.one_of(2, KINDS, "an effect of type")}
        if band["band_type"] == "WaveletWave":
            _semantic(bits)
            own["position"] = len(band["effects"]) * band["block_length"]
            own["wavelet_stream"] = base64.b64encode(
                bytes(bits.whole(8) for _ in range(bits.whole(16)))
            ).decode()
            band["effects"].append(own)
            return  # one to a packet
        own["position"] = bits.signed(25) + (0 if document.is_spatial else document.time)
        if own["effect_type"] == "Basis":
            _semantic(bits)
            own["keyframes"] = _keyframes(bits, band["band_type"])
        known = document.effects.get(name)
        if known is None or own["effect_type"] != "Basis":
            document.effects[name] = own
            band["effects"].append(own)
        else:
            known["keyframes"] += own["keyframes"]


def _semantic(bits: _Bits) -> None:
    if bits.whole(1):
        bits.whole(12)


def _keyframes(bits: _Bits, kind: str) -> list[dict[str, Any]]:
    count, keyframes = bits.whole(16), []
    is_wave = kind == "VectorialWave"
    if is_wave:
        bits.whole(16 + 4)  # phase and base signal
    for _ in range(count):
        flags = bits.whole(2) if is_wave else 1 if kind == "Curve" else 3
        own: dict[str, Any] = {}
        if flags & 1:
            own["amplitude_modulation"] = bits.number(8, -1, 1)
        own["relative_position"] = bits.whole(16)
        if flags & 2:
            own["frequency_modulation"] = float(min(bits.whole(16), _GREATEST))
        keyframes.append(own)
    return keyframes


_READERS: Final = {
    _TIMING: _timing, _PERCEPTION: _perception, _CHANNEL: _channel, _BAND: _band,
    _DATA: _data, _INITIAL_TIMING: _initial_timing,
}  # fmt: skip
