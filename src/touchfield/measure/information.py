"""Information measures of symbol arrays (paper section 3: H(X), H(X,Y), H(X|Y), I(X;Y)).

Each function takes arrays of integers or booleans, of any size and shape, and returns a `Quantity`: the value with
its unit, estimator and interval. Samples at the same place of several arrays are one joint sample.

The estimators are those of `touchfield.measure.estimators`. The interval comes from a block bootstrap over contiguous
blocks of the samples in C order, for neighbours are seldom independent: give `blocks` so that a block is many times
as long as the dependence. Quantised fields have functions of their own, in `touchfield.measure.field_information`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.counted import Counted, Entropies, measured
from touchfield.measure.distribution import NORMALISATIONS, jensen_shannon_bits
from touchfield.measure.histogram import Histogram, JointHistogram, block_counts
from touchfield.measure.symbol_keys import checked_symbols

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from touchfield.measure.quantity import Quantity

    Int64s = NDArray[np.int64]

__all__ = [
    "conditional_entropy",
    "entropy",
    "jensen_shannon_distance",
    "joint_entropy",
    "mutual_information",
    "normalised_mutual_information",
    "variation_of_information",
]

BLOCKS = 64
"""Blocks of the bootstrap, where there are enough samples."""

_NO_ORDER = "no interval: the order of the samples is not known"
_NO_BLOCKS = "no interval: fewer than 8 blocks, for there are too few samples or too many symbols"


def entropy(
    samples: ArrayLike | Iterable[NDArray[Any]] | Histogram,
    *,
    estimator: str = "plug-in",
    alphabet: int | None = None,
    interval: bool = True,
    blocks: int = BLOCKS,
) -> Quantity:
    """H(X), bits a sample.

    Parameters
    ----------
    samples : array of integers or booleans, iterable of such arrays, or Histogram
        Of an iterable each array is counted and let go, so that it may be larger than the memory; neither it nor a
        histogram gets an interval.
    estimator : str
        One of `touchfield.measure.estimators.ESTIMATORS`.
    alphabet : int, optional
        K, how many symbols there are, seen or not; of the estimators only "nsb" depends on it. The estimate and its
        interval are then at most log2 K.
    interval : bool
        Whether to make one; it takes about as long again as the counting, and 200 evaluations of the estimator.
    blocks : int
        Of the bootstrap, 8 or more.

    Returns
    -------
    Quantity

    Warns
    -----
    FewSamplesWarning
        If there are fewer than ten samples to a symbol.

    Raises
    ------
    InvalidArgument
        If there is no sample, a sample is not a whole number, or an option is out of range.
    """
    _check_blocks(blocks)
    given: Any = samples
    held = given if isinstance(given, Histogram) or _in_chunks(given) else checked_symbols(given)
    h = held if isinstance(held, Histogram) else Histogram.of(held)
    made, notes = _blocks_of(held if isinstance(held, np.ndarray) else None, blocks, h) if interval else (None, ())
    one = Entropies(estimator, (), (alphabet,))
    counted = Counted(h.counts, made, h.total, estimator, notes=notes)
    return measured("H(X)", one.joint, counted, most=one.most_bits())


def joint_entropy(
    *samples: ArrayLike, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """H(X,Y,..), bits a joint sample, of arrays of one shape; options and errors as of `entropy`."""
    entropies, counted = _joint(samples, estimator, interval, blocks)
    name = "H(X,Y)" if len(samples) == 2 else f"H({','.join(f'X{i + 1}' for i in range(len(samples)))})"
    return measured(name, entropies.joint, counted)


def conditional_entropy(
    x: ArrayLike, y: ArrayLike, *, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """H(X|Y) = H(X,Y) - H(Y), bits a sample; options and errors as of `entropy`."""
    entropies, counted = _joint((x, y), estimator, interval, blocks)
    return measured("H(X|Y)", lambda c: entropies.given(1, c), counted)


def mutual_information(
    x: ArrayLike, y: ArrayLike, *, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """I(X;Y) = H(X) + H(Y) - H(X,Y), bits a sample; options and errors as of `entropy`.

    With a bias-corrected estimator it may be negative, which a note then says. Plug-in is high by about
    (K_xy - K_x - K_y + 1)/(2 n ln 2) bits.
    """
    entropies, counted = _joint((x, y), estimator, interval, blocks)
    return measured("I(X;Y)", entropies.mutual, counted)


def variation_of_information(
    x: ArrayLike, y: ArrayLike, *, estimator: str = "plug-in", interval: bool = True, blocks: int = BLOCKS
) -> Quantity:
    """VI(X,Y) = H(X|Y) + H(Y|X), bits a sample; options and errors as of `entropy`.

    With plug-in it is a metric between arrays (M. Meila, Journal of Multivariate Analysis 98, 2007).
    """
    entropies, counted = _joint((x, y), estimator, interval, blocks)
    return measured("VI(X,Y)", entropies.variation, counted)


def normalised_mutual_information(
    x: ArrayLike,
    y: ArrayLike,
    by: str = "sqrt",
    *,
    estimator: str = "plug-in",
    interval: bool = True,
    blocks: int = BLOCKS,
) -> Quantity:
    """I(X;Y) over sqrt(H(X) H(Y)), or another of `touchfield.measure.distribution.NORMALISATIONS`.

    0 to 1 with plug-in; NaN where the normaliser is 0, with a note. The other options and errors as of `entropy`.
    """
    _check_normalisation(by)
    entropies, counted = _joint((x, y), estimator, interval, blocks)
    return measured(f"NMI_{by}(X;Y)", lambda c: entropies.normalised(by, c), counted, "1", 1.0)


def jensen_shannon_distance(
    x: ArrayLike | Histogram,
    y: ArrayLike | Histogram,
    *,
    estimator: str = "plug-in",
    interval: bool = True,
    blocks: int = BLOCKS,
) -> Quantity:
    """sqrt(JSD) between the distributions of two samples, 0 to 1 (D. M. Endres and J. E. Schindelin, 2003).

    The samples may differ in size and shape; both distributions have the weight 1/2. For the interval block b of one
    is drawn together with block b of the other, which is right for samples taken side by side and for independent
    ones. Options and errors as of `entropy`, but only plug-in: the mixture has no counts that another estimator
    could correct. The estimate is high for small samples.
    """
    if estimator != "plug-in":
        raise InvalidArgument("estimator", repr(estimator), "plug-in for this distance")
    _check_blocks(blocks)
    samples = tuple(s if isinstance(s, Histogram) else checked_symbols(s) for s in (x, y))
    histograms = [s if isinstance(s, Histogram) else Histogram.of(s) for s in samples]
    if not all(len(h.counts) for h in histograms):
        raise InvalidArgument("samples", "no sample", "at least one of each")
    cells, split = np.union1d(*(h.symbols for h in histograms)), len(histograms[0].counts)
    places = [np.searchsorted(cells, h.symbols) for h in histograms]

    def distance(counts: Int64s) -> float:
        p, q = np.zeros((2, len(cells)))
        p[places[0]], q[places[1]] = counts[:split], counts[split:]
        return math.sqrt(jensen_shannon_bits(p / p.sum(), q / q.sum()))

    made, notes = _paired_blocks(samples, histograms, blocks) if interval else (None, ())
    counts = np.concatenate([h.counts for h in histograms])
    counted = Counted(counts, made, min(h.total for h in histograms), estimator, notes=notes, symbols=len(cells))
    return measured("sqrt(JSD(X,Y))", distance, counted, "sqrt(bit)", 1.0)


# -- counts and blocks ----------------------------------------------------------------------------------------------


def _joint(samples: tuple[ArrayLike, ...], estimator: str, interval: bool, blocks: int) -> tuple[Entropies, Counted]:
    _check_blocks(blocks)
    arrays = tuple(checked_symbols(s) for s in samples)
    h = JointHistogram.of(*arrays)
    made, notes = _blocks_of(arrays, blocks, h) if interval else (None, ())
    places = tuple(h.places(axis) for axis in range(len(arrays)))
    entropies = Entropies(estimator, places, (None,) * (len(arrays) + 1))
    return entropies, Counted(h.counts, made, h.total, estimator, notes=notes)


def _blocks_of(samples: Any, blocks: int, cells: Histogram | JointHistogram) -> tuple[Int64s | None, tuple[str, ...]]:
    if samples is None:
        return None, (_NO_ORDER,)
    if not len(cells.counts):
        return None, ()
    made = block_counts(samples, blocks, cells)
    return made, (_NO_BLOCKS,) if made is None else ()


def _paired_blocks(
    samples: tuple[Any, ...], histograms: list[Histogram], blocks: int
) -> tuple[Int64s | None, tuple[str, ...]]:
    """The counts of both, side by side, in as many blocks of one as of the other."""
    if any(isinstance(s, Histogram) for s in samples):
        return None, (_NO_ORDER,)
    for _ in range(2):  # the second time with what both allow
        made = [block_counts(s, blocks, h) for s, h in zip(samples, histograms, strict=True)]
        if made[0] is None or made[1] is None:
            return None, (_NO_BLOCKS,)
        blocks = min(len(made[0]), len(made[1]))
        if len(made[0]) == len(made[1]):
            break
    assert made[0] is not None and made[1] is not None
    return np.concatenate([made[0], made[1]], axis=1), ()


def _in_chunks(samples: Any) -> bool:
    if isinstance(samples, list | tuple):
        return bool(samples) and all(isinstance(s, np.ndarray) for s in samples)
    return isinstance(samples, Iterator) or (isinstance(samples, Iterable) and not hasattr(samples, "__array__"))


def _check_blocks(blocks: int) -> None:
    if blocks < 8:
        raise InvalidArgument("blocks", f"{blocks}", "8 or more", "Give interval=False for none.")


def _check_normalisation(by: str) -> None:
    if by not in NORMALISATIONS:
        raise InvalidArgument("by", repr(by), f"one of {', '.join(NORMALISATIONS)}")
