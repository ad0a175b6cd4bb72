"""Information quantities of given probabilities, exact (paper section 3: H(X), H(X,Y), H(X|Y), I(X;Y)).

Beside the paper's four stand those by which media are compared: Kullback-Leibler and Jensen-Shannon divergence,
variation of information (M. Meila, Journal of Multivariate Analysis 98, 2007) and normalised mutual information.
All in bits. Probabilities must be given, not counts: for those see `touchfield.measure.information`.
"""

from __future__ import annotations

import math
import operator
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument
from touchfield.measure.quantity import Quantity, normaliser_bits

if TYPE_CHECKING:
    from collections.abc import Sequence


TOLERANCE: Final = 1e-9
"""How far from 1 probabilities may add up."""

# -- plain numbers --------------------------------------------------------------------------------------------------


def _bits(p: Float64s) -> float:
    """-sum p log2 p, with 0 log 0 = 0."""
    held = p[p > 0]
    if len(held) < 2:
        return 0.0  # a certainty, also where its shares add up to 1 - 1e-16
    return float(-(held * np.log2(held)).sum())


def _checked(probabilities: ArrayLike, where: str, dims: int | None) -> Float64s:
    try:
        p = np.asarray(probabilities, np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgument(where, "what is no array of numbers", "probabilities") from error
    if not p.size or p.ndim == 0:
        raise InvalidArgument(where, f"shape {p.shape}", "at least one probability")
    if dims is not None and p.ndim != dims:
        raise InvalidArgument(where, f"shape {p.shape}", "a vector" if dims == 1 else f"{dims} axes")
    if np.isnan(p).any():
        raise InvalidArgument(where, "NaN", "probabilities from 0 to 1")
    if p.min() < 0:
        raise InvalidArgument(where, f"the probability {p.min():.6g}", "probabilities from 0 to 1")
    total = float(p.sum())
    if not abs(total - 1) <= TOLERANCE:
        raise InvalidArgument(
            where, f"a sum of {total:.12g}", f"1 within {TOLERANCE:g}", "Divide counts by their sum."
        )
    return p


def _pair(p: ArrayLike, q: ArrayLike) -> tuple[Float64s, Float64s]:
    a, b = _checked(p, "p", 1), _checked(q, "q", 1)
    if a.shape != b.shape:
        raise InvalidArgument("p and q", f"shapes {a.shape} and {b.shape}", "one shape", "Fill up with zeros.")
    return a, b


def _two(table: ArrayLike) -> tuple[float, float, float]:
    """H(X), H(Y), H(X,Y) of a table with x along the rows' axis 0 and y along axis 1, bits."""
    t = _checked(table, "table", 2)
    return _bits(t.sum(axis=1)), _bits(t.sum(axis=0)), _bits(t)


def _exact(name: str, value: float, symbols: int, unit: str = "bit/sample", notes: tuple[str, ...] = ()) -> Quantity:
    return Quantity(name, value, unit, estimator="exact", symbols=symbols, notes=notes)


def _cells(p: ArrayLike) -> int:
    return int(np.count_nonzero(np.asarray(p)))


# -- of one variable, or a joint one --------------------------------------------------------------------------------


def entropy(p: ArrayLike) -> Quantity:
    """H(X) = -sum p log2 p of a vector of probabilities [K].

    InvalidArgument as every function here: if a probability is negative or NaN, there is none, they do not add up
    to 1 within 1e-9, or the shape is wrong.
    """
    return _exact("H(X)", _bits(_checked(p, "p", 1)), _cells(p))


def joint_entropy(table: ArrayLike) -> Quantity:
    """H(X,Y,..) of a table of joint probabilities, one axis for each variable."""
    return _exact("H(X,Y)", _bits(_checked(table, "table", None)), _cells(table))


def conditional_entropy(table: ArrayLike, given: int | Sequence[int] = 1) -> Quantity:
    """Entropy of the other variables once those of the axes `given` are known, H(X|Y).

    Parameters
    ----------
    table : [Kx, Ky, ..]
        Joint probabilities, at least two axes.
    given : int or sequence of int
        The axes of the known variables.
    """
    t = _checked(table, "table", None)
    if t.ndim < 2:
        raise InvalidArgument("table", f"shape {t.shape}", "at least two axes")
    try:
        axes = tuple(operator.index(a) for a in ((given,) if isinstance(given, int | np.integer) else given))
    except TypeError:
        raise InvalidArgument("given", f"{given!r}", "the number of an axis, or several") from None
    if not all(-t.ndim <= a < t.ndim for a in axes):
        raise InvalidArgument("given", f"{given}", f"axes from {-t.ndim} to {t.ndim - 1}")
    rest = tuple(set(range(t.ndim)) - {a % t.ndim for a in axes})
    return _exact("H(X|Y)", max(0.0, _bits(t) - _bits(t.sum(axis=rest))), _cells(t))


# -- of two ---------------------------------------------------------------------------------------------------------


def mutual_information(table: ArrayLike) -> Quantity:
    """I(X;Y) = H(X) + H(Y) - H(X,Y) of a table [Kx, Ky]."""
    x, y, joint = _two(table)
    return _exact("I(X;Y)", max(0.0, x + y - joint), _cells(table))


def variation_of_information(table: ArrayLike) -> Quantity:
    """VI(X,Y) = H(X|Y) + H(Y|X) of a table [Kx, Ky]; a metric between variables."""
    x, y, joint = _two(table)
    return _exact("VI(X,Y)", max(0.0, 2 * joint - x - y), _cells(table))


def normalised_mutual_information(table: ArrayLike, by: str = "sqrt") -> Quantity:
    """I(X;Y) divided by one of `NORMALISATIONS`, 0 to 1; NaN where that is 0, for then nothing varies.

    Only with "joint" and "max" is 1 - NMI a metric (A. Kraskov and P. Grassberger, 2009; N. X. Vinh et al.,
    Journal of Machine Learning Research 11, 2010).
    """
    x, y, joint = _two(table)
    below = normaliser_bits(x, y, joint, by)
    name = f"NMI_{by}(X;Y)"
    if below == 0:
        return _exact(name, math.nan, _cells(table), "1", (f"0/0: the normaliser {by} is 0 bits",))
    return _exact(name, max(0.0, x + y - joint) / below, _cells(table), "1")


def kullback_leibler_divergence(p: ArrayLike, q: ArrayLike) -> Quantity:
    """D(p||q) = sum p log2(p/q) of two vectors [K]; infinite where q is 0 and p is not."""
    a, b = _pair(p, q)
    held = a > 0
    if (b[held] == 0).any():
        return _exact("D(p||q)", math.inf, _cells(a), notes=("p has symbols that q gives no probability",))
    ratio = np.log2(a[held]) - np.log2(b[held])
    return _exact("D(p||q)", max(0.0, float((a[held] * ratio).sum())), _cells(a))


def jensen_shannon_bits(p: Float64s, q: Float64s) -> float:
    """H((p + q)/2) - (H(p) + H(q))/2 of checked vectors, by a sum of small terms that does not cancel."""
    middle = p + q
    total = 0.0
    for one in (p, q):
        held = one > 0
        total += float((one[held] * (np.log2(one[held]) - np.log2(middle[held]) + 1)).sum())
    return min(1.0, max(0.0, total / 2))


def jensen_shannon_divergence(p: ArrayLike, q: ArrayLike) -> Quantity:
    """JSD(p, q), 0 to 1 bit, of two vectors [K] of equal weight (J. Lin, IEEE Trans. Inf. Theory 37, 1991)."""
    a, b = _pair(p, q)
    return _exact("JSD(p,q)", jensen_shannon_bits(a, b), _cells(a + b))


def jensen_shannon_distance(p: ArrayLike, q: ArrayLike) -> Quantity:
    """sqrt(JSD(p, q)), 0 to 1; a metric (D. M. Endres and J. E. Schindelin, IEEE Trans. Inf. Theory 49, 2003)."""
    a, b = _pair(p, q)
    return _exact("sqrt(JSD(p,q))", math.sqrt(jensen_shannon_bits(a, b)), _cells(a + b), "sqrt(bit)")
