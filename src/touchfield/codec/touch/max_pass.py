"""One run of the kernel of effort `max` over the bricks of a frame, encoding or decoding."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.touch.fixed_field import TOP, FixedField
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.frame_model import Known, Rule
    from touchfield.codec.touch.orientation import Orientation

__all__ = ["Law", "Memory", "Pass", "is_dense"]

_PRICE: Final = 0.12
"""Of a bit, in squares of the step, where any error is allowed: fewest bytes at an equal error; measured."""

_MOST_MISSES: Final = 1 << 16

_WHERE: Final = "frame"


@dataclass
class Memory:
    """What the model learnt from the frames of a segment so far.

    Attributes
    ----------
    support, residual : Mixer
        Chances and weights of both models of bits.
    transitions, sums : dict
        By orientation: how forces change to their neighbours, and the sums of least squares.
    orientation : int or None
        The one taken for the first frame.
    """

    support: Any
    residual: Any
    transitions: dict[int, Any] = field(default_factory=dict)
    sums: dict[int, Any] = field(default_factory=dict)
    orientation: int | None = None

    @classmethod
    def fresh(cls) -> Memory:
        """Nothing learnt."""
        from touchfield.codec.kernels.touch_mixing import fresh_mixer

        return cls(fresh_mixer(17, 40, 20, 10486), fresh_mixer(12, 402, 190, 10486))

    def spent(self) -> NDArray[np.float64]:
        """Bits since this was asked last: of the support, along, across, brick states, and whether anything moved."""
        bits = np.asarray(self.support.spent + self.residual.spent)
        self.support.spent[:] = 0
        self.residual.spent[:] = 0
        return bits


@dataclass(frozen=True)
class Law:
    """What is told of a frame's law, F = K d n (paper section 3.2).

    Attributes
    ----------
    metric : (int, int, int)
        Spacing along the pass's x, y, z over the largest of them, in 1/256, 1 to 256.
    slope : int
        By how many units a force changes over that largest spacing along itself.
    """

    metric: tuple[int, int, int]
    slope: int


def is_dense(bricks: NDArray[np.int32]) -> bool:
    """Whether bricks lie close enough for planes of their box to be held: 4096 samples a brick, and 65536."""
    if not len(bricks):
        return True
    size = np.sort(bricks.max(axis=0).astype(np.int64) - bricks.min(axis=0) + 1)
    return int(size[1] * size[2]) * BRICK**2 <= 4096 * len(bricks) + 65536


class Pass:
    """One run of the kernel over a frame's bricks.

    Parameters
    ----------
    known : Known
    bricks : int32 [n, 3]
        At least one.
    turn : Orientation
    law : Law
    """

    def __init__(self, known: Known, bricks: NDArray[np.int32], turn: Orientation, law: Law) -> None:
        from touchfield.codec.kernels.touch_max_window import GIVEN, fresh_work
        from touchfield.codec.kernels.touch_planes import fresh_planes
        from touchfield.codec.kernels.touch_transition import fresh_transitions
        from touchfield.codec.touch.warp import warp_of

        self.memory = Memory.fresh() if known.memory is None else deepcopy(known.memory)
        lattice = known.lattice
        self._turn, self._grid, self._unturned, self._unit_n = turn, known.grid, bricks, lattice.unit_n
        turned, _, self._order = turn.turned(known.grid, bricks, np.zeros((len(bricks), 1, 1, 1, 3), np.int32))
        self._corner, self._shape = turned.min(axis=0), turned.max(axis=0) - turned.min(axis=0) + 1
        self._bricks = turned - self._corner
        shape = tuple(int(n) for n in self._shape)
        self._layers = _layers(self._bricks, shape[0])
        self._before, self._ahead = self._other(known.previous), self._other(known.guess)
        above = self._bricks - np.array([1, 0, 0], np.int32)
        pairs = ((self._bricks, self._before[0]), (self._bricks, self._ahead[0]), (above, self._bricks))
        self._links = np.stack([_places(wanted, listed, shape) for wanted, listed in pairs], axis=-1)
        self._planes = tuple(fresh_planes(shape[1], shape[2]) for _ in range(3))
        most = 192 * int(np.diff(self._layers).max())
        self._work = fresh_work(shape[1], shape[2], most, len(self._before[0]) + len(self._ahead[0]) > 0)
        if turn.number in self.memory.sums:
            self._work.sums[:] = self.memory.sums[turn.number]
        self._work.sums[GIVEN] = 0
        self.memory.sums[turn.number] = self._work.sums
        self._transitions = self.memory.transitions.setdefault(turn.number, fresh_transitions(law.slope))
        self._warp = warp_of(lattice.floor, lattice.rate)
        self._lattice = np.array([lattice.floor, lattice.rate, lattice.cross_floor, lattice.cross_rate], np.int64)
        self._metric = np.array([*law.metric, law.slope, 0], np.int64)

    def _other(self, field: FixedField | None) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]:
        """Another field's bricks within the box of the frame's own."""
        count = int(self._shape[0])
        if field is None:
            return np.zeros((0, 3), np.int32), np.zeros(count + 1, np.int64), np.zeros((0, 8, 8, 8, 3), np.int32)
        bricks, vectors, _ = self._turn.turned(self._grid, field.bricks, field.vectors)
        bricks = bricks - self._corner
        near = ((bricks >= 0) & (bricks < self._shape)).all(axis=1)
        bricks, vectors = np.ascontiguousarray(bricks[near]), np.ascontiguousarray(vectors[near])
        return bricks, _layers(bricks, count), vectors

    def encode(
        self, units: NDArray[np.float64], rule: Rule, bytes_a_sample: int
    ) -> tuple[bytes, NDArray[np.int32], NDArray[np.int64]] | None:
        """The arithmetic code, the decoded vectors and the misses; None where the code needs more bytes."""
        from touchfield.codec.kernels.mixer import Coder
        from touchfield.codec.kernels.touch_max_choice import chain_breaks

        _, original, _ = self._turn.turned(self._grid, self._unturned, units)
        unit_n = float(np.float32(self._unit_n))
        flags = (float(rule.free), float(self._lattice[0]), float(rule.movable))
        numbers = np.array([rule.k, rule.f0_n / unit_n, rule.sine, _PRICE if rule.free else rule.thrift, *flags])
        breaks = chain_breaks(original, self._metric, numbers, self._before, self._ahead, self._links)
        ways, self._metric[4] = _ways(breaks, int(np.count_nonzero(original.any(axis=-1))))
        coder = Coder(np.empty(len(units) * BRICK**3 * bytes_a_sample + 8192, np.uint8), False, (1, 1), 1)
        misses = np.zeros(_MOST_MISSES, np.int64)
        status, out = self._run(coder, original, numbers, misses, ways)
        if status != 0:
            return None
        place, end = coder.tail()
        code = bytes([self._metric[4]]) + coder.buffer[:place].tobytes() + end
        return code, self._turn.back(out, self._order), self._slots(misses[1 : misses[0] + 1])

    def decode(self, data: bytes) -> NDArray[np.int32]:
        """The vectors, int32 [n, 8, 8, 8, 3].

        Raises
        ------
        TruncatedFile
            If the code ends too early.
        """
        from touchfield.codec.kernels.mixer import Coder

        if not data:
            raise TruncatedFile(_WHERE, "no byte of its code", "at least 1")
        self._metric[4] = data[0]
        coder = Coder(np.frombuffer(data, np.uint8, offset=1).copy(), True, (1, 1), 1)
        none = np.zeros((0, 8, 8, 8, 3), np.float64)
        status, out = self._run(coder, none, np.zeros(7), np.zeros(1, np.int64), np.zeros(0, np.int64))
        if status != 0:
            raise TruncatedFile(_WHERE, f"the end of the code after {len(data)} bytes", "all samples of its bricks")
        place, end = coder.tail()
        if data[1 + place :] != end:
            raise CorruptFile(
                _WHERE, f"{len(data)} bytes", f"a code of {1 + place + len(end)}", "The file was changed."
            )
        return self._turn.back(out, self._order)

    def _slots(self, slots: NDArray[np.int64]) -> NDArray[np.int64]:
        """Slots of the pass as slots of the grid's own bricks."""
        own = np.arange(len(self._unturned) * BRICK**3).reshape(-1, BRICK, BRICK, BRICK, 1).repeat(3, axis=-1)
        # a turn may change signs, so that a slot is told by its size
        turned: NDArray[np.int64] = self._turn.turned(self._grid, self._unturned, own)[1][..., 0]
        return np.abs(turned.reshape(-1)[slots])

    def _run(
        self,
        coder: Any,
        original: NDArray[np.float64],
        rule: NDArray[np.float64],
        misses: NDArray[np.int64],
        ways: NDArray[np.int64],
    ) -> tuple[int, NDArray[np.int32]]:
        from touchfield.codec.kernels import touch_max

        code_frame: Any = touch_max.code_frame
        low, high = (edge - BRICK * self._corner for edge in self._turn.bounds(self._grid))
        out = np.zeros((len(self._bricks), BRICK, BRICK, BRICK, 3), np.int32)
        status = code_frame(
            self._bricks, self._layers, low, high, out, original, rule, self._lattice, *self._warp, self._metric,
            TOP + TOP // 4, TOP // 3, self._before, self._ahead, self._links, ways,
            (self.memory.support, self.memory.residual), *self._planes, self._work, self._transitions,
            int(coder.decoding), coder.state, coder.buffer, misses,
        )  # fmt: skip
        return int(status), out


def _layers(bricks: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Where each layer of bricks begins, int64 [count + 1]."""
    return np.searchsorted(bricks[:, 0], np.arange(count + 1)).astype(np.int64)


def _places(wanted: NDArray[np.int32], listed: NDArray[np.int32], shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Where in a list each of some bricks stands, or -1; a brick may lie one before the first layer."""

    def keys(b: NDArray[np.int32]) -> NDArray[np.int64]:
        return (b[:, 0].astype(np.int64) * shape[1] + b[:, 1]) * shape[2] + b[:, 2]

    mine, theirs = keys(wanted), keys(listed)
    if not len(theirs):
        return np.full(len(mine), -1, np.int64)
    at = np.minimum(np.searchsorted(theirs, mine), len(theirs) - 1)
    return np.where(theirs[at] == mine, at, -1)


_MIX_BREAKS: Final = 1.5
"""A mean of neighbours breaks more often than the simulation tells, which does not know the noise of closed loops."""

_CLEAN: Final = 0.2
"""Below this share of breaks a frame follows one chain everywhere; above, a quarter of the mean is mixed in."""

_WORTH: Final = 40
"""Breaks that a brick's own way must spare."""


def _ways(breaks: NDArray[np.int64], held: int) -> tuple[NDArray[np.int64], int]:
    """How each brick is predicted, int64 [n], and the share of the mean in it, of 256.

    As is best for the frame, unless another way is much better for the brick: where chains of two axes meet, both
    break.
    """
    cost = breaks * np.array([_MIX_BREAKS, 1.0, 1.0, 1.0, 1.0, 1.0])
    usual = int(cost.sum(axis=0).argmin())
    clean = cost[:, usual].sum() < _CLEAN * max(1, held)
    if clean and usual < 4:
        return np.full(len(cost), usual), 0
    gain = cost[:, usual] - cost.min(axis=1)
    return np.where(gain > _WORTH, cost.argmin(axis=1), usual), 0 if clean or usual == 4 else 64
