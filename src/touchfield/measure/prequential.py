"""The prequential code length: bits that a sequential code surely needs no more than (theory section 5).

A context entropy is a promise about infinitely many voxels; what a coder pays on *these* voxels includes learning
the chances. Dawid's prequential principle (1984) charges each decision with -log2 of a chance computed from the past
only, so that the sum is the length of a real code, to within two bits, and an honest upper bound. Frame after frame:

1. which bricks hold anything: Krichevsky-Trofimov estimates in six nested sets of contexts (the causal neighbours'
   and the previous frame's flags), under a Bayesian mixture. KT lengths depend on counts alone, so that the empty
   bricks of any lattice are paid for in closed form;
2. the voxels of those bricks, brick after brick in raster order: "is there a force?";
3. where there is one, its symbol: first digit, then second (see `split`), each bit by bit along a binary tree, from
   the highest down.

2 and 3 are decisions in mixed contexts (`kernels/prequential.py`), never more than one bit longer in all than
order-0 KT. Arrays have no bricks: all their voxels are decided in raster order. The alphabet, the split and the shape
are taken as known to the decoder; nothing else is.

Cost: some 0.3 microseconds for each binary decision; 32 MiB of tables and the frame before. Of an array, given whole,
one box at a time is copied.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.causal import (
    array_frames,
    array_of,
    boxes_of,
    extents_of,
    frames_of,
    haloed,
    reached_bricks,
    scan_relabelled,
)
from touchfield.measure.context import per_supported
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.quantity import Quantity
from touchfield.medium.field import slots_around

_LOWER: Final = (0, 1, 3, 4, 9, 10, 12)  # of the 27 bricks around one, those of {-1, 0}^3
_BEFORE: Final = 1 << 7
_AXES: Final = 1 << 3 | 1 << 5 | 1 << 6  # bricks 4, 10 and 12
_MODELS: Final = (0, _AXES, 127, _BEFORE, _BEFORE | _AXES, _BEFORE | 127)
"""Flags that each set of contexts looks at: none, the axis neighbours, the corner; and the same with the brick's own
flag in the previous frame."""

_VOXELS_AT_ONCE: Final = 1 << 15


def kt_code_length_bits(zeros: ArrayLike, ones: ArrayLike) -> Float64s:
    """Bits of the Krichevsky-Trofimov code for binary sequences with so many zeros and ones, in any order.

    -log2 B(zeros + 1/2, ones + 1/2) / pi, B being the beta function: the chance of the next one is (ones + 1/2) /
    (n + 1). It never exceeds n H + log2(n)/2 + 1, H being the plug-in entropy (IEEE Trans. Inf. Theory 27, 1981).

    InvalidArgument if a count is negative or not finite.
    """
    from scipy.special import betaln

    n0, n1 = np.asarray(zeros, np.float64), np.asarray(ones, np.float64)
    for name, n in (("zeros", n0), ("ones", n1)):
        if not (np.isfinite(n) & (n >= 0)).all():
            raise InvalidArgument(name, "a count that is negative or not finite", "at least 0")
    length: Float64s = (math.log(math.pi) - betaln(n0 + 0.5, n1 + 0.5)) / math.log(2)
    return np.maximum(length, 0.0)


@dataclass(frozen=True)
class FrameBits:
    """Costs of one frame.

    `bricks`: bits for which bricks hold anything. `support`: bits for where in them. `symbols`: bits for what.
    """

    bricks: float
    support: float
    symbols: float

    @property
    def total(self) -> float:
        """All bits."""
        return self.bricks + self.support + self.symbols


@dataclass(frozen=True)
class PrequentialLength:
    """A code length, frame by frame.

    `frames` tuple of FrameBits: the first is coded without a previous frame. `per_frame`, `per_voxel`,
    `per_supported`: the mean, bit/frame; bit/sample over all voxels; over the voxels that are not 0 (NaN where
    there is none).
    """

    frames: tuple[FrameBits, ...]
    per_frame: Quantity
    per_voxel: Quantity
    per_supported: Quantity

    @property
    def total_bits(self) -> float:
        """All bits of all frames."""
        return math.fsum(f.total for f in self.frames)

    def summary(self) -> dict[str, Any]:
        """Plain values under stable keys."""
        parts = np.array([astuple(f) for f in self.frames])
        return {
            "total_bits": self.total_bits,
            "bits": dict(zip(("bricks", "support", "symbols"), parts.sum(axis=0).tolist(), strict=True)),
            "frame_bits": parts.sum(axis=1).tolist(),
            "per_frame": self.per_frame.summary(),
            "per_voxel": self.per_voxel.summary(),
            "per_supported": self.per_supported.summary(),
        }


class PrequentialCoder:
    """The code and what it has learnt.

    `alphabet`: K; symbols are 0 .. K - 1. `split`: D, if symbol s > 0 is ``1 + first * D + second``, such as an
    amplitude level and a direction of a codebook of D: then each is coded in the contexts of its own kind. 1 .. K -
    1; without it a symbol is one digit. InvalidArgument if a number is out of range.
    """

    def __init__(self, alphabet: int, split: int | None = None) -> None:
        from touchfield.measure.kernels.prequential import Model

        most = max(1, alphabet - 1)
        if split is not None and not 1 <= split <= most:
            raise InvalidArgument("split", f"{split}", f"1 to {most}, the symbols that are not 0")
        lower = most if split is None else int(split)
        self.alphabet = alphabet
        self._model = Model((-(-most // lower), lower))
        self._flags = np.zeros((256, 2), np.int64)
        self._before: FieldSymbols | None = None
        self._array_before: NDArray[Any] | None = None
        self._frames: list[FrameBits] = []
        self._voxels = self._supported = 0

    def add_field(self, frame: FieldSymbols) -> FrameBits:
        """The bits of the next frame, sparse; what is learnt from it serves the following ones."""
        from touchfield.measure.kernels.prequential import code_bricks

        held = frame.symbols.any(axis=(1, 2, 3))
        kept = FieldSymbols(frame.grid, frame.bricks[held], frame.symbols[held], frame.alphabet, frame.quantiser)
        before = self._before or FieldSymbols(frame.grid, kept.bricks[:0], kept.symbols[:0], frame.alphabet, "")
        if frame.alphabet > self.alphabet or before.grid != frame.grid:
            raise InvalidArgument("frame", "another grid or a larger alphabet", "those of the frames before")
        brick_bits = self._brick_bits(kept, before)
        slots = tuple(slots_around(kept.bricks, f.bricks, frame.grid.brick_shape) for f in (kept, before))
        symbols = (np.array(kept.symbols), np.array(before.symbols))
        start = self._model.totals.copy()
        code_bricks(self._model, (slots[0], slots[1]), symbols, extents_of(frame.grid, kept.bricks))
        self._before = kept
        return self._told(brick_bits, start, frame.voxel_count, kept.object_count)

    def add_array(self, frame: NDArray[Any]) -> FrameBits:
        """The bits of the next frame, int [nx, ny, nz]; it is kept, uncopied, until the one after it is coded."""
        from touchfield.measure.kernels.prequential import HIGH, LOW, code_block

        if frame.max() >= self.alphabet:
            raise InvalidArgument("frame", f"symbol {frame.max()}", f"below the alphabet {self.alphabet}")
        before = self._array_before
        if before is not None and before.shape != frame.shape:
            raise InvalidArgument("frame", f"shape {frame.shape}", f"{before.shape}, as the frame before")
        start = self._model.totals.copy()
        for box in boxes_of(frame.shape, _VOXELS_AT_ONCE):
            now = haloed(frame, box, LOW, HIGH)
            old = np.zeros_like(now) if before is None else haloed(before, box, LOW, HIGH)
            truth = now[LOW:-HIGH, LOW:-HIGH, LOW:-HIGH].copy()
            # what comes in raster order from the first voxel of the box on is yet to be told
            now[LOW + 1 :] = 0
            now[LOW, LOW + 1 :] = 0
            now[LOW, LOW, LOW:] = 0
            code_block(self._model, truth, now, old)
        self._array_before = frame
        return self._told(0.0, start, frame.size, int(np.count_nonzero(frame)))

    def _told(self, brick_bits: float, start: Float64s, voxels: int, supported: int) -> FrameBits:
        support, symbols, _ = (self._model.totals - start).tolist()
        found = FrameBits(brick_bits, support, symbols)
        self._frames.append(found)
        self._voxels += voxels
        self._supported += supported
        return found

    def _brick_bits(self, frame: FieldSymbols, before: FieldSymbols) -> float:
        """Bits of the flags: what the mixture of all models grows by."""
        grid = frame.grid
        bricks = reached_bricks(grid, frame, before)
        around = slots_around(bricks, frame.bricks, grid.brick_shape) >= 0
        context = (around[:, _LOWER] << np.arange(7)).sum(axis=1)
        context += _BEFORE * (slots_around(bricks, before.bricks, grid.brick_shape)[:, 13] >= 0)
        start = _mixture_bits(self._flags)
        np.add.at(self._flags, (context, around[:, 13].astype(np.int64)), 1)
        self._flags[0, 0] += math.prod(grid.brick_shape) - len(bricks)  # all others have no flag near and none own
        return _mixture_bits(self._flags) - start

    def result(self, quantiser: str = "as given", weighting: str = "samples") -> PrequentialLength:
        """The bits of all frames so far; there must be one."""
        if not self._frames:
            raise InvalidArgument("frames", "no frame", "at least one")
        total = math.fsum(f.total for f in self._frames)
        notes = ["upper bound: the length of a sequential code"]
        if self._model.shares_order0:
            notes.append("the alphabet is larger than the table of the order-0 estimate, so that chances are shared")
        per_voxel = Quantity(
            "L(S)", total / self._voxels, "bit/sample", quantiser, weighting, "prequential", self._voxels,
            self.alphabet, None, tuple(notes),
        )  # fmt: skip
        return PrequentialLength(
            tuple(self._frames),
            per_voxel.times(self._voxels / len(self._frames), "bit/frame"),
            per_voxel,
            per_supported(per_voxel, self._voxels, self._supported),
        )


def _mixture_bits(flags: Int64s) -> float:
    """-log2 of the mean over the models of the chance each gives to all flags so far."""
    context = np.arange(256)
    lengths = []
    for looked_at in _MODELS:
        counts = np.zeros((256, 2), np.int64)
        np.add.at(counts, context & looked_at, flags)
        lengths.append(float(kt_code_length_bits(counts[:, 0], counts[:, 1]).sum()))
    shortest = min(lengths)
    return shortest - math.log2(math.fsum(2.0 ** (shortest - length) for length in lengths) / len(lengths))


def prequential_code_length(
    frames: Any, *, alphabet: int | None = None, split: int | None = None
) -> PrequentialLength:
    """How many bits a sequential adaptive code needs for these symbols.

    InvalidArgument for values that are not symbols or not below the alphabet, a split out of range, or frames that
    do not match.

    Parameters
    ----------
    frames : int array of 1 to 4 dimensions, FieldSymbols, or an iterable of FieldSymbols
        Symbols from 0 (no force) on; the first of four axes is time.
    alphabet : int, optional
        K, of an array; its largest symbol + 1 if it is not given. Fields know theirs.
    split : int, optional
        The number of directions, or any other second digit; see `PrequentialCoder`.

    Returns
    -------
    PrequentialLength
        Estimator "prequential".

    Examples
    --------
    >>> import numpy as np
    >>> prequential_code_length(np.zeros(10_000, int), alphabet=2).total_bits < 10
    True
    """
    x = array_of("frames", frames)
    if x is not None:
        coder = PrequentialCoder(int(x.max()) + 1 if alphabet is None else int(alphabet), split)
        for array in array_frames(x):
            coder.add_array(array)
        return coder.result()
    coder_of: PrequentialCoder | None = None
    quantiser = ""
    for frame in map(scan_relabelled, frames_of(frames)):
        if alphabet not in (None, frame.alphabet):
            raise InvalidArgument("alphabet", f"{alphabet}", f"{frame.alphabet}, as the fields say")
        coder_of = coder_of or PrequentialCoder(frame.alphabet, split)
        coder_of.add_field(frame)
        quantiser = frame.quantiser
    assert coder_of is not None  # frames_of refuses none
    return coder_of.result(quantiser, "voxel")
