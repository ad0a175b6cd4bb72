"""Computes the entropy of the frames after the first: a sample whose change is within the mask needs no bits
(paper section 5.1).

"The entropy of the second frame till the last one is on average 1.6 and 0.8 as far as object-based and
voxel-based representation is concerned [..] because there are many samples that need zero bits for their
representation since their respective force value falls within the perceptual mask." Held samples are one
symbol of their own, "hold".

*corrected*: against what the receiver holds, as a vector; a sample is held if it lies within the mask of
that, or has the same codeword. Object samples are those where there is a force or the receiver still holds
one.

*literal*: eq. 8 as printed. Amplitudes alone, against the frame before whether it was sent or not; a held
sample is written as 0, and so is a force of zero. Object samples are those where there is a force.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from touchfield.measure.estimators import entropy_bits
from touchfield.medium.field import brick_keys
from touchfield.perception.weber import gate_in_time

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField

    Float32s = NDArray[np.float32]
    Int64s = NDArray[np.int64]

__all__ = ["Codewords", "LaterFrames", "consecutive_runs", "later_frames"]

HOLD: Final = -1


class Codewords(Protocol):
    """A quantiser that can decode."""

    def symbols_of(self, vectors_n: Float32s, /) -> NDArray[np.int32]:
        """Symbols of forces [m, 3]; 0 is "no force"."""

    def vectors_of(self, symbols: NDArray[np.int32], /) -> Float32s:
        """Forces of symbols [m]."""


@dataclass(frozen=True)
class LaterFrames:
    """Means over the later frames.

    Attributes
    ----------
    voxel_bits, object_bits : float
        Bits a sample.
    held_share : float
        Of the object samples.
    frames : int
    """

    voxel_bits: float
    object_bits: float
    held_share: float
    frames: int


def consecutive_runs(frame_count: int, runs: int, length: int) -> list[range]:
    """Evenly spaced runs of consecutive frames; the first of each is a reference and not counted."""
    length = min(length + 1, frame_count)
    runs = max(1, min(runs, frame_count // length))
    firsts = np.linspace(0, frame_count - length, runs).astype(int)
    return [range(first, first + length) for first in firsts.tolist()]


def later_frames(
    medium: Callable[[int], ForceField],
    runs: Sequence[range],
    quantisers: Mapping[str, Codewords],
    k: float,
    report: Callable[[int, int], None] = lambda done, total: None,
) -> dict[tuple[str, str], LaterFrames]:
    """Entropies of later frames, for each reading ("literal", "corrected") and quantiser.

    Parameters
    ----------
    medium : callable
        ``medium(i)``: frame i.
    runs : sequence of range
        See `consecutive_runs`.
    quantisers : mapping
    k : float
        Of the mask.
    report : callable
        ``report(done, total)``.
    """
    tallies = {
        (reading, words): _READINGS[reading](codewords, k)
        for reading in _READINGS
        for words, codewords in quantisers.items()
    }
    done, total = 0, sum(len(run) for run in runs)
    for run in runs:
        for frame in run:
            field = medium(frame)
            for tally in tallies.values():
                tally.take(field, is_first=frame == run[0])
            done += 1
            report(done, total)
    return {key: tally.means() for key, tally in tallies.items()}


class _Tally(ABC):
    """What a receiver holds, and the entropies so far."""

    def __init__(self, codewords: Codewords, k: float) -> None:
        self.codewords, self.k = codewords, k
        self.keys, self.held = np.zeros(0, np.int64), np.zeros((0, 512, 3), np.float32)
        self.sums, self.frames = np.zeros(3), 0

    def take(self, field: ForceField, is_first: bool) -> None:
        keys, values = brick_keys(field.grid, field.bricks), field.forces_n.reshape(-1, 512, 3)
        if is_first:
            self.keys, self.held = keys, self.kept_of_first(values)
            return
        union = np.union1d(keys, self.keys)
        now, before = _placed(union, keys, values), _placed(union, self.keys, self.held)
        symbols, is_object, kept = self.coded(now.reshape(-1, 3), before.reshape(-1, 3))
        self.keys, self.held = union, kept.reshape(-1, 512, 3)
        objects = symbols[is_object]
        seen, counts = np.unique(objects, return_counts=True)
        silent = int(counts[seen == self.silence].sum())
        every = np.append(counts[seen != self.silence], field.grid.voxel_count - len(objects) + silent)
        held = silent / max(1, len(objects))
        self.sums += entropy_bits(every), entropy_bits(counts), held
        self.frames += 1

    def means(self) -> LaterFrames:
        voxel, objects, held = (self.sums / max(1, self.frames)).tolist()
        return LaterFrames(voxel, objects, held, self.frames)

    silence = HOLD
    """The symbol of empty space, and of what is held."""

    @abstractmethod
    def kept_of_first(self, values: Float32s) -> Float32s:
        """What the next frame is compared with, of a frame that is sent whole."""

    @abstractmethod
    def coded(self, now: Float32s, before: Float32s) -> tuple[NDArray[np.int32], NDArray[np.bool_], Float32s]:
        """Symbols [m]; which samples are the object's; and what the next frame is compared with, of [m,
        3].
        """


class _Corrected(_Tally):
    def kept_of_first(self, values: Float32s) -> Float32s:
        decoded = self.codewords.vectors_of(self.codewords.symbols_of(values.reshape(-1, 3)))
        return decoded.reshape(values.shape)

    def coded(self, now: Float32s, before: Float32s) -> tuple[NDArray[np.int32], NDArray[np.bool_], Float32s]:
        is_object = np.asarray(now.any(axis=1) | before.any(axis=1))
        symbols = np.full(len(now), HOLD, np.int32)
        x, reference = now[is_object], before[is_object]
        own = self.codewords.symbols_of(x)
        decoded = self.codewords.vectors_of(own)
        sent = gate_in_time(x, reference, self.k) & (decoded != reference).any(axis=1)
        symbols[is_object] = np.where(sent, own, HOLD)
        kept = before.copy()
        kept[is_object] = np.where(sent[:, None], decoded, reference)
        return symbols, is_object, kept


class _Literal(_Tally):
    silence = 0

    def kept_of_first(self, values: Float32s) -> Float32s:
        return values

    def coded(self, now: Float32s, before: Float32s) -> tuple[NDArray[np.int32], NDArray[np.bool_], Float32s]:
        a, last = (np.linalg.norm(v.astype(np.float64), axis=1) for v in (now, before))
        held = (last - self.k * last < a) & (a < last + self.k * last)
        symbols = np.where(held, 0, self.codewords.symbols_of(now)).astype(np.int32)
        return symbols, np.asarray(now.any(axis=1)), now


_READINGS: dict[str, type[_Tally]] = {"literal": _Literal, "corrected": _Corrected}


def _placed(union: Int64s, keys: Int64s, values: Float32s) -> Float32s:
    placed = np.zeros((len(union), 512, 3), np.float32)
    placed[np.searchsorted(union, keys)] = values
    return placed
