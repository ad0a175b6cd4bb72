"""How alike two haptic media are, from their symbols (paper section 4: "similarity estimation").

The paper names no measure. Here are four, of two quantised media S and T on one lattice:

===================  ==========================================  ==================================================
measure              compares                                    metric
===================  ==========================================  ==================================================
NMI                  symbols voxel by voxel                      no
VI                   symbols voxel by voxel                      yes, over "voxel"
sqrt(JSD)            histograms of the symbols, wherever         yes, over either
                     they lie
NCD                  what one medium tells a compressor of the   no; see `touchfield.measure.similarity`
                     other, at any shift
===================  ==========================================  ==================================================

"Metric" is said of the plug-in estimates, and holds up to what a measure cannot see: VI and NMI are blind to another
name for each symbol, and sqrt(JSD) to where symbols lie, so that two media that differ in this alone are at
distance 0. Over "object", NMI and VI look at the voxels where one of the two has a force; that set differs from pair
to pair, and the triangle inequality no longer holds.

Sources: M. Meila, Journal of Multivariate Analysis 98, 2007 (VI); N. X. Vinh et al., Journal of Machine Learning
Research 11, 2010, and A. Kraskov and P. Grassberger, 2009 (NMI); D. M. Endres and J. E. Schindelin, IEEE Trans. Inf.
Theory 49, 2003 (sqrt(JSD)).
"""

from __future__ import annotations

import lzma
import math
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.counts import ABSENT
from touchfield.measure.field_count import field_counts, supported
from touchfield.measure.field_symbols import Fields, Frames
from touchfield.measure.information import (
    jensen_shannon_distance,
    normalised_mutual_information,
    variation_of_information,
)
from touchfield.measure.quantity import Quantity
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK

MOST_BYTES: Final = 1 << 25
"""Of the packed symbols of both media; lzma takes about twelve times as much memory."""

_COUNT_BYTES: Final = 8
_NOT_A_METRIC: Final = "not a metric: NCD(x,x) is not 0, and the triangle inequality holds only nearly"


def compression_distance(first: Fields, second: Fields) -> Quantity:
    """NCD of two media of one lattice and one Q, by lzma; about 0 for equal ones, about 1 for unrelated ones.

    `first`, `second`: FieldSymbols or sequences of them, each frame asked for once; they may differ in length. Gives
    "NCD(S,T)", unit "1", mu "voxel". InvalidArgument if lattice or Q differ, or both together take more than 32 MiB
    when packed.
    """
    a, b = Frames(first, "first"), Frames(second, "second")
    if (a.grid, a.quantiser, a.alphabet) != (b.grid, b.quantiser, b.alphabet):
        raise InvalidArgument("second", "another lattice or quantiser", "those of the first")
    voxels = a.grid.voxel_count * (a.count + b.count)
    one = packed(a, MOST_BYTES)
    x, y = sorted([one, packed(b, MOST_BYTES - len(one))], key=lambda d: (len(d), d))  # in whatever order
    window = max(1 << 12, 1 << (len(x) + len(y)).bit_length())
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 6, "dict_size": window}]
    sizes = [len(lzma.compress(d, lzma.FORMAT_RAW, filters=filters)) for d in (x, y, x + y)]
    value = (sizes[2] - min(sizes[:2])) / max(sizes[:2])
    notes = ("C is lzma", _NOT_A_METRIC)
    return Quantity("NCD(S,T)", value, "1", a.quantiser, "voxel", "lzma", samples=voxels, notes=notes)


def packed(frames: Frames, most_bytes: int = MOST_BYTES) -> bytes:
    """The symbols of all frames as bytes, the same for the same symbols however they are stored.

    For each frame the number of bricks that hold a force, the place of each as the distance from the one before it,
    and its 512 symbols, in whole bytes, the low bytes of a brick before the high ones.

    InvalidArgument if there are more than `most_bytes`.
    """
    width = max(1, -(-(frames.alphabet - 1).bit_length() // 8))
    parts: list[bytes] = []
    total = 0
    for n in range(frames.count):
        field = frames.take(n)
        held = field.symbols.any(axis=(1, 2, 3))
        total += _COUNT_BYTES + int(held.sum()) * (_COUNT_BYTES + BRICK**3 * width)
        if total > most_bytes:
            raise InvalidArgument(
                "symbols to compress", f"more than {MOST_BYTES >> 20} MiB of both media",
                f"up to {MOST_BYTES >> 20} MiB", "Take fewer frames, a coarser lattice, or no NCD.",
            )  # fmt: skip
        keys = brick_keys(field.grid, field.bricks[held])
        symbols = field.symbols[held].reshape(len(keys), BRICK**3).astype("<u4")
        planes = symbols.view(np.uint8).reshape(len(keys), BRICK**3, 4)[:, :, :width].transpose(0, 2, 1)
        parts += [len(keys).to_bytes(_COUNT_BYTES, "little"), np.diff(keys, prepend=0).astype("<u8").tobytes()]
        parts.append(planes.tobytes())
    return b"".join(parts)


@dataclass(frozen=True)
class Similarity:
    """Measures that tell two media apart; each a `Quantity`.

    Attributes
    ----------
    normalised : Quantity
        Normalised I(S;T): 1 where each symbol of one medium tells that of the other, 0 where it tells nothing.
    variation : Quantity
        VI(S,T), bits a sample.
    jensen_shannon : Quantity
        sqrt(JSD) between the histograms of symbols, 0 to 1.
    compression : Quantity or None
        NCD, about 0 to 1; None where it was not asked for.
    """

    normalised: Quantity
    variation: Quantity
    jensen_shannon: Quantity
    compression: Quantity | None

    def summary(self) -> dict[str, Any]:
        """Plain values by name."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: None if value is None else value.summary() for name, value in values.items()}


def similarity(
    first: Fields, second: Fields, over: str = "voxel", *, compressed: bool = True, interval: bool = True
) -> Similarity:
    """Compare two media of one lattice and one Q, by plug-in counts: the bias-corrected estimates are no metrics.

    InvalidArgument if the media differ in lattice, Q or length, an option is unknown, over "object" one of them has
    no force, or the symbols are too many to compress.

    Parameters
    ----------
    first, second : FieldSymbols, or sequences of as many
        S and T. "One Q" means that a symbol is the same codeword in both: a quantiser that is fitted to data is to be
        fitted to both media at once. Frame i is compared with frame i. Sequences may make their frames when asked
        for them; each is asked for at most twice, and once more for the NCD.
    over : "voxel" or "object"
        mu of NMI and VI: all voxels, or those where one of the two has a force. sqrt(JSD) over "object" compares
        the symbols of the forces of each medium.
    compressed : bool
        Whether to make the NCD, which takes the longest.
    interval : bool
        Whether NMI, VI and sqrt(JSD) get a block-bootstrap interval, of 27 parts of space.
    """
    _check_alike(Frames(first, "first"), Frames(second, "second"))
    counts = supported(field_counts(first, second, (over,), interval=interval)[over])
    apart = jensen_shannon_distance(counts, absent=0 if over == "object" else ABSENT)
    if math.isnan(apart.value):
        supported(replace(counts, cells=counts.cells[:0], weights=counts.weights[:0]))
    compression = compression_distance(first, second) if compressed else None
    return Similarity(normalised_mutual_information(counts), variation_of_information(counts), apart, compression)


def _check_alike(a: Frames, b: Frames) -> None:
    if a.grid != b.grid:
        raise InvalidArgument(
            "second", f"the grid {b.grid}", f"{a.grid}, as of the first",
            "Resample one onto the lattice of the other (touchfield.filters.resample), then quantise both.",
        )  # fmt: skip
    if (a.quantiser, a.alphabet) != (b.quantiser, b.alphabet):
        raise InvalidArgument(
            "second", f"the quantiser {b.quantiser} with {b.alphabet} symbols",
            f"{a.quantiser} with {a.alphabet}, as of the first", "Fit one quantiser to both media at once.",
        )  # fmt: skip
    if a.count != b.count:
        raise InvalidArgument(
            "second", f"{b.count} frames", f"{a.count}, as many as the first", "Take the frames that both have."
        )
