"""Entropy from counts: six estimators (paper section 3, which defines the entropy of known probabilities only).

The paper takes frequencies for probabilities, the plug-in estimate. It is low by about (K - 1)/(2 n ln 2) bits for
K symbols and n samples, and half a bit low for a thousand codewords and as many samples, so other estimators stand
beside it. All of them see only how many symbols were counted how often, and all converge on the entropy for large n.

Measured bias in bits, mean of 3000 draws. ``zipf``: p ~ 1/rank, K = n = 1000, H = 7.489, one draw spreads by 0.10.
``sparse``: 97 % zeros and 512 symbols as 1/rank, n = 10 000, H = 0.4006, one draw spreads by 0.02.

============== ===== ====== =================================================================
estimator       zipf sparse use
============== ===== ====== =================================================================
plug-in        -0.60 -0.027 the paper's; identities such as the chain rule hold exactly
miller-madow   -0.36 -0.017 cheap and safe; still low where most symbols are rare
grassberger    -0.16 -0.009 as miller-madow, and better for small counts
chao-shen      -0.07 +0.059 many unseen symbols; too high for a field that is mostly empty
chao-wang-jost -0.07 -0.004 many unseen symbols, alphabet unknown, empty or not
nsb            -0.04 -0.004 the same, alphabet known
============== ===== ====== =================================================================

The expectation of the first three is a sum of binomial probabilities, which the tests compare.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument
from touchfield.measure.symbol_keys import as_array
from touchfield.medium.field import frozen


def entropy_bits(counts: ArrayLike) -> float:
    """Plug-in entropy -sum p log2 p of a histogram, bits a sample; 0 for an empty one.

    Exact to rounding also where one symbol dominates, such as the empty space around one brick.
    """
    n = np.asarray(counts, np.float64).ravel()
    n = n[n > 0]
    if not len(n):
        return 0.0
    total = n.sum()
    common = int(n.argmax())
    others = np.delete(n, common)
    rest = others.sum()
    if rest < n[common]:  # its share is nearly 1, and what is left of a difference of logarithms would be rounding
        p = others / total
        return float(-(1 - rest / total) * np.log1p(-rest / total) / np.log(2) - (p * np.log2(p)).sum()) + 0.0
    return float(max(0.0, np.log2(total) - (n * np.log2(n)).sum() / total))


def binary_entropy_bits(p: float) -> float:
    """h2(p), bits."""
    return entropy_bits([p, 1.0 - p])


# -- The Nemenman-Shafee-Bialek estimate of entropy, stable for any n and K (paper section 3, H(X), estimated)


POINTS: Final = 65  # of the first look; doubled until the estimate stands
MOST_POINTS: Final = 513
TOLERANCE: Final = 1e-12
DROP_NATS: Final = 50.0  # exp(-50) is far below what a double can add to 1
_MAX_TERMS: Final = 1 << 20
_FAR: Final = 30.0  # from here on the asymptotic series is exact to rounding


def nsb_nats(counts: Float64s, times: Float64s, alphabet: float) -> float:
    """The posterior mean of the entropy, nats.

    `counts` float64 [d]: the different counts, all at least 1. `times` float64 [d]: how many symbols were counted
    so often. `alphabet`: K, at least the sum of `times`.
    """
    if alphabet == 1:
        return 0.0
    low, high = _posterior_range(counts, times, alphabet)
    points, before, estimate = POINTS, math.nan, math.nan
    while points <= MOST_POINTS and not abs(estimate - before) <= TOLERANCE * estimate:
        u = np.linspace(low, high, points)
        log_weight = _in_parts(_log_posterior, u, counts, times, alphabet)
        weight = np.exp(log_weight - log_weight.max())
        entropies = _in_parts(_mean_entropy, u, counts, times, alphabet)
        before, estimate = estimate, float((weight * entropies).sum() / weight.sum())
        points = 2 * points - 1
    return estimate


def _posterior_range(counts: Float64s, times: Float64s, alphabet: float) -> tuple[float, float]:
    """Where in ln beta the posterior is within DROP_NATS of its largest value, a little wide."""
    n = float((counts * times).sum())
    low, high = -math.log(alphabet) - DROP_NATS - 10, 2 * math.log(n) + DROP_NATS + 10
    while True:
        u = np.linspace(low, high, POINTS)
        log_weight = _in_parts(_log_posterior, u, counts, times, alphabet)
        held = np.flatnonzero(log_weight > log_weight.max() - DROP_NATS)
        first, last = max(held[0] - 1, 0), min(held[-1] + 1, POINTS - 1)
        if last - first > POINTS // 2:
            return low, high
        low, high = float(u[first]), float(u[last])


def _in_parts(
    function: Callable[[Float64s, Float64s, Float64s, float], Float64s],
    u: Float64s,
    counts: Float64s,
    times: Float64s,
    alphabet: float,
) -> Float64s:
    """``function(u, ...)`` without ever holding more than about 2^20 terms."""
    at_once = max(1, _MAX_TERMS // len(counts))
    parts = [function(u[i : i + at_once], counts, times, alphabet) for i in range(0, len(u), at_once)]
    return np.concatenate(parts)


def _log_posterior(u: Float64s, counts: Float64s, times: Float64s, alphabet: float) -> Float64s:
    """ln of prior times likelihood times d beta/d u, to a constant, at u = ln beta [m]."""
    beta = np.exp(u)
    kappa = alphabet * beta
    likelihood: Float64s = _log_rising(beta[:, None], counts) @ times - _log_rising(kappa, (counts * times).sum())
    return likelihood + np.log(_prior_slope(beta, kappa))


def _log_rising(x: Float64s, m: Float64s) -> Float64s:
    """ln [Gamma(x + m)/Gamma(x)], without the cancellation of two large logarithms for large x."""
    from scipy.special import gammaln

    near = np.minimum(x, _FAR)
    far = np.maximum(x, _FAR)
    y = far + m
    stirling = (far - 0.5) * np.log1p(m / far) + m * np.log(y) - m + _stirling_rest(y) - _stirling_rest(far)
    return np.where(x < _FAR, gammaln(near + m) - gammaln(near), stirling)


def _stirling_rest(x: Float64s) -> Float64s:
    q = 1 / (x * x)
    rest: Float64s = (1 / 12 - q * (1 / 360 - q * (1 / 1260 - q / 1680))) / x
    return rest


def _prior_slope(beta: Float64s, kappa: Float64s) -> Float64s:
    """d xi/d ln beta = r(kappa) - r(beta), r(z) = z psi_1(z + 1), which runs from 0 to 1."""
    slope = np.where(kappa < _FAR, _rise(kappa) - _rise(beta), _rest(beta) - _rest(kappa))
    return np.asarray(slope, np.float64)


def _rise(z: Float64s) -> Float64s:
    from scipy.special import zeta

    r: Float64s = z * zeta(2.0, z + 1)
    return r


def _rest(z: Float64s) -> Float64s:
    """1 - r(z), also where r(z) is 1 to rounding."""
    y = 1 / np.maximum(z, _FAR)
    q = y * y
    series = y * (1 / 2 - y * (1 / 6 - q * (1 / 30 - q * (1 / 42 - q / 30))))
    return np.where(z < _FAR, 1 - _rise(np.minimum(z, _FAR)), series)


def _mean_entropy(u: Float64s, counts: Float64s, times: Float64s, alphabet: float) -> Float64s:
    """The posterior mean of the entropy at each ln beta [m], nats (Wolpert and Wolf 1995)."""
    from scipy.special import digamma

    beta = np.exp(u)
    total = float((counts * times).sum()) + alphabet * beta
    unseen = alphabet - times.sum()
    terms = ((counts + beta[:, None]) * digamma(counts + beta[:, None] + 1)) @ times
    mean: Float64s = digamma(total + 1) - (terms + unseen * beta * digamma(beta + 1)) / total
    return mean


# -- Entropy from counts: six estimators (paper section 3, which defines the entropy of known probabilities only)


@dataclass(frozen=True)
class Tally:
    """Counts as an estimator sees them: how many symbols were counted how often.

    `counts` float64 [d]: the different counts, whole numbers of at least 1, ascending. `times` float64 [d]: how
    many symbols were counted so often.
    """

    counts: Float64s
    times: Float64s

    @property
    def samples(self) -> float:
        """n."""
        return float((self.counts * self.times).sum())

    @property
    def observed(self) -> float:
        """How many symbols were seen at least once."""
        return float(self.times.sum())

    def seen(self, count: int) -> float:
        """How many symbols were seen exactly `count` times, f_count in the literature."""
        place = int(np.searchsorted(self.counts, count))
        return float(self.times[place]) if place < len(self.counts) and self.counts[place] == count else 0.0


@dataclass(frozen=True)
class Estimator:
    """One estimator of entropy.

    `nats`: ``nats(tally, alphabet)``: the estimate in nats. `alphabet` is K where it is known, else the observed
    number. `is_biased_low`: the expected value is at most the entropy for every distribution and every n (a
    theorem, and a shared test). `uses_alphabet`: the estimate depends on K, so that it is worth knowing.
    `corrects_bias`: most of the bias is taken off, so that an interval must not take it off again
    (`touchfield.measure.bootstrap.interval`).
    """

    name: str
    nats: Callable[[Tally, float], float]
    is_biased_low: bool
    uses_alphabet: bool
    corrects_bias: bool
    source: str


def tally(counts: ArrayLike) -> Tally:
    """Count the counts; zeros are left out.

    InvalidArgument if counts are negative, not whole, not finite, or none is above zero.
    """
    n = as_array(counts, "counts").ravel()
    if n.dtype.kind not in "biuf":
        raise InvalidArgument("counts", f"values of type {n.dtype}", "whole numbers of at least 0")
    if n.dtype.kind == "f" and not np.isfinite(n).all():
        raise InvalidArgument("counts", "NaN or infinity", "whole numbers of at least 0")
    if n.size and n.min() < 0:
        raise InvalidArgument("counts", f"{n.min()}", "whole numbers of at least 0")
    if n.dtype.kind == "f" and (fractions := n[n != np.floor(n)]).size:
        raise InvalidArgument("counts", f"{fractions[0]}", "whole numbers", "Probabilities have an exact entropy.")
    values, times = np.unique(n[n > 0], return_counts=True)
    if not values.size:
        raise InvalidArgument("counts", "no sample", "at least one count above 0")
    return Tally(frozen(values.astype(np.float64)), frozen(times.astype(np.float64)))


def plug_in(t: Tally, alphabet: float) -> float:
    """-sum p ln p at p = count/n, the maximum-likelihood estimate (paper section 3). Low for every n, by Jensen."""
    n = t.samples
    p = t.counts / n
    log_p = np.log(p)
    rest = float((t.counts[:-1] * t.times[:-1]).sum())
    if t.times[-1] == 1 and rest < t.counts[-1]:
        log_p[-1] = np.log1p(-rest / n)  # p is nearly 1 where one symbol dominates, and its logarithm lost
    return float(-(t.times * p * log_p).sum()) + 0.0  # 0, and not -0


def miller_madow(t: Tally, alphabet: float) -> float:
    """Plug-in + (K - 1)/(2n), K being the observed symbols.

    G. A. Miller, "Note on the bias of information estimates", in Information Theory in Psychology, 1955.
    """
    return plug_in(t, alphabet) + (t.observed - 1) / (2 * t.samples)


def grassberger(t: Tally, alphabet: float) -> float:
    """ln n - (1/n) sum n_i G(n_i), G(m) = psi(m) + (-1)^m/2 [psi((m + 1)/2) - psi(m/2)].

    P. Grassberger, "Entropy estimates from insufficient samplings", arXiv:physics/0307138, 2003 (the version of 2008
    keeps it); not his estimate of 1988, whose last term is (-1)^m/(m (m + 1)).
    """
    from scipy.special import digamma

    m = t.counts
    sign = 1.0 - 2.0 * np.mod(m, 2.0)
    g = digamma(m) + sign / 2 * (digamma((m + 1) / 2) - digamma(m / 2))
    return math.log(t.samples) - float((t.times * m * g).sum()) / t.samples


def chao_shen(t: Tally, alphabet: float) -> float:
    """Horvitz-Thompson sum over the observed symbols, their shares scaled by Good's coverage C = 1 - f_1/n.

    A. Chao and T.-J. Shen, "Nonparametric estimation of Shannon's index of diversity when there are unseen species
    in sample", Environmental and Ecological Statistics 10, 2003. Departure: where every sample is another symbol C
    would be 0 and the sum undefined; f_1 = n - 1 is taken then.
    """
    n = t.samples
    coverage = 1 - min(t.seen(1), n - 1) / n
    p = coverage * t.counts / n
    chance = -np.expm1(n * np.log1p(-np.minimum(p, 1 - 2.0**-53)))  # of being seen; 1 where p is 1
    return float(-(t.times * p * np.log(p) / chance).sum())


def chao_wang_jost(t: Tally, alphabet: float) -> float:
    """sum n_i/n [psi(n) - psi(n_i)] + the tail of the species accumulation curve, from f_1 and f_2.

    A. Chao, Y. T. Wang and L. Jost, "Entropy and the species accumulation curve", Methods in Ecology and Evolution
    4, 2013. Its last term is written as the sum over j >= 1 of (1 - A)^j/(n - 1 + j), which loses no
    digits, where the printed difference of a logarithm and a finite sum loses all for large n.
    """
    from scipy.special import digamma

    n, once, twice = t.samples, t.seen(1), t.seen(2)
    seen = float((t.times * t.counts * (digamma(n) - digamma(t.counts))).sum()) / n
    if once == 0 or n == 1:
        return seen
    if twice:
        a = 2 * twice / ((n - 1) * once + 2 * twice)
    else:
        a = 2 / ((n - 1) * (once - 1) + 2)
    return seen + once / n * _geometric_tail(a, n)


def _geometric_tail(a: float, n: float) -> float:
    """sum over j >= 1 of (1 - a)^j/(n - 1 + j), for 0 < a <= 1 and n >= 1.

    It is the integral over s > 0 of x e^-s/(n (1 - x e^(-s/n))), x = 1 - a, by the trapezoidal rule in ln s: the
    integrand is analytic for |arg s| < pi/2 and dies on both sides, so that the rule is exact to rounding.
    """
    if a >= 1:
        return 0.0
    step, low, high = 0.1, math.log(min(1.0, a * n)) - 40, 4.0
    s = np.exp(np.arange(low, high, step))
    log_x = math.log1p(-a)
    return float(step * (s * np.exp(log_x - s) / (-n * np.expm1(log_x - s / n))).sum())


def _nsb(t: Tally, alphabet: float) -> float:
    return nsb_nats(t.counts, t.times, alphabet)


ESTIMATORS: Final[Mapping[str, Estimator]] = MappingProxyType(
    {
        e.name: e
        for e in (
            Estimator("plug-in", plug_in, True, False, False, "maximum likelihood"),
            Estimator("miller-madow", miller_madow, False, False, True, "Miller 1955"),
            Estimator("grassberger", grassberger, False, False, True, "Grassberger 2003"),
            Estimator("chao-shen", chao_shen, False, False, True, "Chao and Shen 2003"),
            Estimator("chao-wang-jost", chao_wang_jost, False, False, True, "Chao, Wang and Jost 2013"),
            Estimator("nsb", _nsb, False, True, True, "Nemenman, Shafee and Bialek 2002"),
        )
    }
)
"""The registered estimators, by name."""


def estimate_bits(counts: ArrayLike, estimator: str = "plug-in", alphabet: int | None = None) -> float:
    """The entropy that counts speak of, bits a sample.

    An estimate outside 0 .. log2 K is taken to the nearer end, which can only mend it; the upper end holds where
    `alphabet` is given.

    InvalidArgument if the estimator is unknown, the counts are negative, not whole, not finite or without a sample,
    or the alphabet is smaller than the number of observed symbols.

    Parameters
    ----------
    counts : int array, any shape
        How often each symbol was seen; zeros are ignored, floats must be whole.
    estimator : str
        One of `ESTIMATORS`.
    alphabet : int, optional
        K, how many symbols there are. Only "nsb" depends on it; without it, "nsb" takes what was observed for all
        there is, and its estimate is then low where symbols were missed.
    """
    if estimator not in ESTIMATORS:
        raise InvalidArgument("estimator", repr(estimator), f"one of {', '.join(ESTIMATORS)}")
    t = tally(counts)
    if alphabet is not None and not (t.observed <= alphabet < math.inf and alphabet == int(alphabet)):
        raise InvalidArgument(
            "alphabet", f"{alphabet}", f"a whole number of at least {t.observed:.0f}, the observed symbols"
        )
    nats = ESTIMATORS[estimator].nats(t, t.observed if alphabet is None else float(alphabet))
    most = math.inf if alphabet is None else math.log2(alphabet)
    return min(max(0.0, nats / math.log(2)), most)  # 0.0 first, which is then kept instead of -0.0
