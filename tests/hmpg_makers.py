"""Effects in the binary form of MPEG haptics, made bit by bit."""

from __future__ import annotations

Fields = list[tuple[int, int]]  # value, bits


def text(word: str) -> Fields:
    return [(len(word), 8), *((ord(letter), 8) for letter in word)]


def quantised(value: float, low: float, high: float, bits: int) -> tuple[int, int]:
    return (round((value - low) / (high - low) * ((1 << bits) - 1)), bits)


def pack(fields: Fields) -> bytes:
    value = count = 0
    for field, bits in fields:
        value, count = value << bits | field & ((1 << bits) - 1), count + bits
    return (value << (-count % 8)).to_bytes((count + 7) // 8, "big")


def packet(kind: int, fields: Fields) -> bytes:
    data = pack(fields)
    return pack([(kind, 6), (len(data), 17), (0, 1)]) + data


def unit(kind: int, ticks: int, *packets: bytes) -> bytes:
    data = b"".join(packets)
    return pack([(kind, 6), (0, 2), (0, 4), (ticks, 24), (len(data), 32), (0, 4)]) + data


def head(modality: int, *channels: bytes) -> bytes:
    perception = [
        (0, 8), (0, 8), *text("p"), (modality, 8), (0, 8), (0, 16), (0, 1), (-3, 8), (0, 8), (1, 8),
        (1, 8), *text("vest"), (0, 32), (0b100000000001, 12), (5, 32), (2, 4), (len(channels), 16),
    ]  # fmt: skip
    haptics = [*text("2023"), *text("Main"), (1, 8), *text("now"), *text(""), (1, 8), (0, 8)]
    timing = [(0, 32), (1000, 32), (128, 24), (0, 24), (0, 1)]
    return unit(0, 0, packet(11, timing), packet(1, haptics), packet(2, perception), *channels)


def channel(number: int, gain: float, direction: tuple[int, int, int] | None = None) -> bytes:
    aim = [] if direction is None else [(axis, 8) for axis in direction]
    return packet(3, [
        (number, 16), (0, 8), (0, 8), *text("c"), (1, 8),
        quantised(gain, -1e4, 1e4, 32), quantised(1, 0, 1e4, 32),
        (1 if direction is None else 5, 8), (0x10, 32), (0, 32), *aim, (0, 16), (1, 8),
    ])  # fmt: skip


def band(number: int, of: int, kind: int, more: Fields) -> bytes:
    return packet(4, [(number, 8), (0, 8), (of, 16), (0, 8), (kind, 3), *more, (0, 16), (1000, 16), (1, 16)])


def curve(
    position: int, *keyframes: tuple[int, float], effect: int = 7, of: int = 0, number: int = 0
) -> bytes:
    points = [item for tick, value in keyframes for item in (quantised(value, -1, 1, 8), (tick, 16))]
    header = [(0, 1), (0, 8), (of, 16), (number, 8), (1, 16), (effect, 16), (0, 2), (position, 25), (0, 1)]
    return packet(5, [*header, (len(keyframes), 16), *points])


LINEAR: Fields = [(2, 4)]
FILE = (
    head(6, channel(0, 0.5), band(0, 0, 1, LINEAR))
    + unit(1, 128, curve(20, (0, 1.0), (100, 0.5)))
    + unit(3, 128)
    + unit(1, 128, curve(-236, (300, 1.0), (400, -1.0)))  # the same effect, continued two units later
)
