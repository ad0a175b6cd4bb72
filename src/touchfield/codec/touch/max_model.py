"""The frame model of effort `max`: one raster pass with many mixed contexts.

The bytes of a frame: the orientation, the metric less 1 (three bytes), varint slope, a chunk with the list of bricks
(a support code in which all bricks are full), one byte for the share of the mean in a chain's prediction, and one
arithmetic code of all else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.touch.fixed_field import TOP, FixedField
from touchfield.codec.touch.frame_model import CodedFrame, DecodedFrame
from touchfield.codec.touch.max_pass import Law, Pass, is_dense
from touchfield.codec.touch.old_brick_list import read_bricks, write_bricks
from touchfield.codec.touch.orientation import Orientation, sampled
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from touchfield.codec.touch.frame_model import Known, Rule
    from touchfield.medium import ForceField

__all__ = ["MaxModel"]

_STEEP: Final = 48
_USUAL_SLOPE: Final = TOP // 12


class MaxModel:
    """See the module; `FrameModel` tells what it does."""

    number: Final = 2

    def encode(self, frame: ForceField, known: Known, rule: Rule) -> CodedFrame:
        """Code one frame; the first of a segment in several orientations, of which the best is kept."""
        held = _held(frame, rule)
        bricks, forces = frame.bricks[held], frame.forces_n[held]
        if not len(bricks):
            data = _head(Orientation(0), Law((1, 1, 1), 0), known.grid, bricks)
            none = FixedField(bricks, np.zeros((0, BRICK, BRICK, BRICK, 3), np.int32))
            return CodedFrame(data, none, (8.0 * len(data), 0.0, 0.0), np.zeros(0, np.int64), known.memory)
        turns = list(_orientations(forces, known))
        part = None if len(turns) == 1 else sampled(bricks, forces)
        if part is not None:
            turns = [min(turns, key=lambda turn: _cost(_coded(turn, bricks[part], forces[part], known, rule)))]
        return min((_coded(turn, bricks, forces, known, rule) for turn in turns), key=_cost)

    @staticmethod
    def takes(frame: ForceField, rule: Rule) -> bool:
        """Whether the bricks to be told lie close enough; the planes that the pass holds are dense."""
        return is_dense(frame.bricks[_held(frame, rule)])

    def decode(self, payload: bytes, known: Known) -> FixedField:
        """The inverse."""
        return self.decode_with_memory(payload, known).field

    def decode_with_memory(self, payload: bytes, known: Known) -> DecodedFrame:
        """The inverse, and what was learnt."""
        if len(payload) < 4:
            raise TruncatedFile("frame", f"{len(payload)} bytes", "at least 4")
        if payload[0] >= 48:
            raise CorruptFile("frame orientation", str(payload[0]), "0 to 47")
        turn = Orientation(payload[0])
        slope, at = read_varint(payload, 4, "frame slope", TOP + 1)
        bricks, at = read_bricks(payload, at, known.grid, "frame bricks")
        if not is_dense(bricks):
            raise CorruptFile("frame bricks", f"{len(bricks)} far apart", "4096 samples of a plane for each at most")
        code = payload[at:]
        if not len(bricks):
            if code:
                raise CorruptFile("frame", f"{len(code)} bytes behind an empty frame", "none")
            return DecodedFrame(FixedField(bricks, np.zeros((0, BRICK, BRICK, BRICK, 3), np.int32)), known.memory)
        one = Pass(known, bricks, turn, Law((payload[1] + 1, payload[2] + 1, payload[3] + 1), slope))
        vectors = one.decode(code)
        one.memory.spent()
        one.memory.orientation = turn.number
        return DecodedFrame(FixedField(bricks, vectors), one.memory)


def _coded(
    turn: Orientation, bricks: NDArray[np.int32], forces: NDArray[np.float32], known: Known, rule: Rule
) -> CodedFrame:
    """A frame coded in one orientation."""
    law = _law(turn, bricks, forces, known)
    head = _head(turn, law, known.grid, bricks)
    units = forces.astype(np.float64) / np.float64(np.float32(known.lattice.unit_n))
    for bytes_a_sample in (4, 32, 512):
        one = Pass(known, bricks, turn, law)
        made = one.encode(units, rule, bytes_a_sample)
        if made is not None:
            break
    else:
        raise AssertionError("a sample of more than 512 bytes")
    code, vectors, misses = made
    spent = one.memory.spent()
    one.memory.orientation = turn.number
    bits = (float(spent[0] + spent[3]) + 8 * len(head), float(spent[1] + spent[4]), float(spent[2]))
    return CodedFrame(head + code, FixedField(bricks, vectors), bits, misses, one.memory)


def _cost(coded: CodedFrame) -> int:
    """Bytes, with those of what must be sent apart."""
    return len(coded.payload) + 12 * len(coded.misses)


def _head(turn: Orientation, law: Law, grid: Grid, bricks: NDArray[np.int32]) -> bytes:
    told = bytes([turn.number, *(m - 1 for m in law.metric)])
    return told + write_varint(law.slope) + write_bricks(grid, bricks)


def _held(frame: ForceField, rule: Rule) -> NDArray[np.bool_]:
    """The bricks that must be told: those with a force that may not be dropped."""
    if not rule.movable or rule.free:
        return np.ones(len(frame.bricks), np.bool_)
    x = frame.forces_n.astype(np.float64)
    held: NDArray[np.bool_] = ((x * x).sum(axis=-1) > (rule.f0_n * (1 - 1e-9)) ** 2).any(axis=(1, 2, 3))
    return held


def _orientations(forces: NDArray[np.float32], known: Known) -> Iterator[Orientation]:
    """The orientations to try: that of the segment's frames before, or some about the axes of the mean force.

    Deep before shallow along the main axis, from where the forces point away from; or the second axis slowest, and
    shallow before deep in it, which on walls of real rooms took 2 to 9 % less.
    """
    if known.memory is not None and known.memory.orientation is not None:
        yield Orientation(known.memory.orientation)
        return
    mean = forces.reshape(-1, 3).sum(axis=0, dtype=np.float64)
    c, b, a = (int(i) for i in np.argsort(np.abs(mean), kind="stable"))
    deep, second = bool(mean[a] < 0), bool(mean[b] < 0)
    yield Orientation.of((a, c, b), (deep, False, False))
    if known.guess is not None:
        return
    yield Orientation.of((a, c, b), (deep, True, False))
    yield Orientation.of((b, a, c), (second, not deep, False))
    yield Orientation.of((b, a, c), (not second, not deep, False))


def _law(turn: Orientation, bricks: NDArray[np.int32], forces: NDArray[np.float32], known: Known) -> Law:
    """The metric, and by how many units a force changes over the largest spacing: the median of the frame."""
    spacing = np.array([known.grid.spacing_m[a] for a in turn.axes[::-1]])
    x, y, z = (int(m) for m in np.clip(np.floor(256 * spacing / spacing.max() + 0.5), 1, 256))
    turned = turn.turned(known.grid, bricks, forces)[1].astype(np.float64) / known.lattice.unit_n
    a = np.sqrt((turned**2).sum(axis=-1))
    low, high = a[:, :-1], a[:, 1:]
    ramp = (low > 0) & (high > 0) & (low < 0.97 * TOP) & (high < 0.97 * TOP)
    along = turned[:, :-1, ..., 2][ramp] / low[ramp] * z
    steep = np.abs(along) > _STEEP
    if not steep.any():
        return Law((x, y, z), _USUAL_SLOPE)
    change = (low[ramp] - high[ramp])[steep] * 256 / along[steep]
    return Law((x, y, z), int(np.clip(np.median(change), 0, TOP)))
