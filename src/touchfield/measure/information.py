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
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.bootstrap import Interval
from touchfield.measure.distribution import jensen_shannon_bits
from touchfield.measure.histogram import Histogram, JointHistogram, block_counts
from touchfield.measure.quantity import Counted, Entropies, Quantity, check_normalisation, measured
from touchfield.measure.symbol_keys import checked_symbols

if TYPE_CHECKING:
    from touchfield.measure.quantity import Quantity


# -- mutual information of continuous pairs, from nearest neighbours


PARTS: Final = 10
MIN_PART_SAMPLES: Final = 50
TIE_NOISE: Final = 1e-10
LEVEL: Final = 0.95


def ksg_mutual_information(x: ArrayLike, y: ArrayLike, k: int = 3, seed: int = 0) -> Quantity:
    """I(X;Y) of paired samples, bits a sample.

    Measured on Gaussian pairs of correlation 0 / 0.6 / 0.9 (n = 5000, k = 3, 100 draws):
    bias -0.004 / -0.001 / +0.004 bits, spread 0.016 / 0.019 / 0.022, 95 % intervals that hold the truth 91 / 95 / 96.

    InvalidArgument if the lengths differ, a value is not finite, or k does not fit n.

    Parameters
    ----------
    x, y : float [n] or [n, d]
        Pairs by their first axis; d may differ. Dense data: many equal values (a quantised signal) ask for
        symbols and a plug-in estimate instead, and a note says so.
    k : int
        Which neighbour, 1 .. n - 1. Small: less bias, more spread; 3 to 5 is usual.
    seed : int
        Of the noise that parts ties.

    Returns
    -------
    Quantity
        "I(X;Y)", may be slightly below 0 for independent pairs. With an interval (see above) from 500 samples on.
    """
    columns = [_columns(x, "x"), _columns(y, "y")]
    n = len(columns[0])
    if len(columns[1]) != n:
        raise InvalidArgument("y", f"{len(columns[1])} samples", f"{n}, as many as x")
    if not (1 <= k < n and int(k) == k):
        raise InvalidArgument("k", f"{k}", f"a whole number from 1 to {n - 1}, one less than the samples")
    base = Quantity("I(X;Y)", 0.0, "bit/sample", estimator="ksg", samples=n)
    for name, c in zip("xy", columns, strict=True):
        if (c == c[0]).all():
            return base.of(notes=(f"{name} is constant, so that it tells nothing about the other",))
    return _measured(base, columns, int(k), seed)


def _measured(base: Quantity, columns: list[Float64s], k: int, seed: int) -> Quantity:
    rng = np.random.default_rng(seed)
    ties = max(1 - len(np.unique(c, axis=0 if c.shape[1] > 1 else None)) / base.samples for c in columns)
    scaled = [_unit_spread(c) for c in columns]
    a, b = (c + TIE_NOISE * rng.standard_normal(c.shape) for c in scaled)
    value = _ksg_nats(a, b, k) / math.log(2)
    notes = [f"k = {k}, maximum norm"]
    if ties > 0.01:
        share = f"{ties:.0%} of the samples of x or y repeat others and are parted by noise"
        notes.append(f"{share}: count symbols where the data are quantised")
    if value < 0:
        notes.append("below 0 by chance: no dependence seen")
    spread = _interval(value, a, b, k)
    if spread is None:
        notes.append(f"no interval: it needs {PARTS * MIN_PART_SAMPLES} samples")
    return base.of(value=value, interval=spread, notes=tuple(notes))


def _columns(values: ArrayLike, name: str) -> Float64s:
    """float64 [n, d], finite."""
    try:
        given = np.asarray(values)
    except ValueError as error:
        raise InvalidArgument(name, "rows of different lengths", "numbers [n] or [n, d]") from error
    if given.dtype.kind not in "biuf" or given.ndim not in (1, 2) or len(given) < 2 or not given.size:
        raise InvalidArgument(name, f"{given.dtype} {given.shape}", "numbers [n] or [n, d] with n at least 2")
    c = given.astype(np.float64).reshape(len(given), -1)
    if not np.isfinite(c).all():
        raise InvalidArgument(name, "NaN or infinity", "finite numbers", "Leave those pairs out.")
    return c


def _unit_spread(columns: Float64s) -> Float64s:
    """Zero mean and unit standard deviation for each column; a constant column becomes zero."""
    c = columns - columns.mean(axis=0)
    c /= np.maximum(np.abs(c).max(axis=0), np.finfo(np.float64).tiny)  # squares of huge or tiny values stay finite
    deviation = c.std(axis=0)
    scaled: Float64s = c / np.where(deviation > 0, deviation, 1.0)
    return scaled


def _ksg_nats(x: Float64s, y: Float64s, k: int) -> float:
    """Algorithm 1, on columns [n, d] without ties."""
    from scipy.spatial import cKDTree
    from scipy.special import digamma

    from touchfield.parallel import worker_count

    joint = np.hstack([x, y])
    distance, _ = cKDTree(joint).query(joint, k=[k + 1], p=np.inf, workers=worker_count())
    reach = distance[:, 0]
    mean = (digamma(_nearer(x, reach)) + digamma(_nearer(y, reach))).mean()
    return float(digamma(k) + digamma(len(x)) - mean)


def _nearer(points: Float64s, reach: Float64s) -> Int64s:
    """How many points lie strictly nearer than `reach` to each point, itself among them: n_x + 1."""
    from scipy.spatial import cKDTree

    from touchfield.parallel import worker_count

    if points.shape[1] > 1:
        inside = np.nextafter(reach, 0)
        found = cKDTree(points).query_ball_point(points, inside, p=np.inf, workers=worker_count(), return_length=True)
        return np.asarray(found, np.int64)
    line = points[:, 0]
    order = np.sort(line)
    inside = reach - 4 * np.spacing(np.abs(line) + reach)  # so that rounding of line +- reach never lets the rim in
    upper = np.searchsorted(order, line + inside, side="right")
    lower = np.searchsorted(order, line - inside, side="left")
    return np.asarray(np.maximum(upper - lower, 1), np.int64)


def _interval(value: float, x: Float64s, y: Float64s, k: int) -> Interval | None:
    from scipy.special import stdtrit

    if len(x) < PARTS * max(MIN_PART_SAMPLES, k + 1):
        return None
    parts = [_ksg_nats(a, b, k) for a, b in zip(np.array_split(x, PARTS), np.array_split(y, PARTS), strict=True)]
    deviation = float(np.std(parts, ddof=1)) / math.log(2) / math.sqrt(PARTS)
    half = float(stdtrit(PARTS - 1, (1 + LEVEL) / 2)) * deviation
    return Interval(value - half, value + half, LEVEL, f"{PARTS} contiguous parts, Student t")


# -- symbol arrays


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

    FewSamplesWarning if there are fewer than ten samples to a symbol. InvalidArgument if there is no sample, a
    sample is not a whole number, or an option is out of range.

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
    check_normalisation(by)
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
