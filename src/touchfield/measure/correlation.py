"""How much a picture tells of the haptic medium of the same scene (paper section 4: "correlation analysis between
haptic media and visual media").

The paper names the analysis and gives none. Here it is I(V;A): V is the luma or depth of a pixel, A the |F| that a
hand meets along the pixel's ray (`touchfield.measure.correlation`), both of one size, pixel for pixel, each in
classes of equal shares, and mu uniform over the pixels where both are known. A pixel whose ray meets nothing is left
out, so that the outline of a body alone makes no correlation.

*Is it chance?* Pixels depend on their neighbours, so that a shuffle of single pixels would call any two smooth
pictures related. Whole square blocks of the second picture are shuffled instead, which keeps what holds within a
block (P. Good, Permutation, Parametric, and Bootstrap Tests of Hypotheses, 2005). How far two independent pictures
agree by chance grows with the sum of the products of their autocorrelations (M. S. Bartlett, Supplement to the
Journal of the Royal Statistical Society 8, 1946), so that the blocks must be larger than the distance over which both
are like themselves: by default their side is the smallest power of two of at least four times the shift at which
that product falls to 1/e. Where the picture does not hold 16 such blocks a smaller one is taken, and a note says that
p is then too small. Dependence across the borders of blocks is lost in any case, so that p is a little too small for
smooth pictures: of 60 pairs of independent ones (64 x 64, smoothed by 1.5 pixels) 7 % had p <= 0.05. A trend across
the whole picture in both is dependence in the sense of this test.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.estimators import estimate_bits
from touchfield.measure.information import mutual_information
from touchfield.measure.quantity import FewSamplesWarning, Quantity
from touchfield.medium import BRICK
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from touchfield.medium import ForceField


READINGS: Final = ("first", "peak")
MOST_LOOKUPS: Final = 1 << 31
_RAYS = 1 << 16  # at a time


@dataclass(frozen=True)
class Contact:
    """Points that rays meet first.

    Attributes
    ----------
    amplitudes_n : float64 [...]
        |F|, newtons; NaN where a ray meets no force.
    distances_m : float64 [...]
        From the start of the ray to that sample's step, metres; NaN likewise.
    """

    amplitudes_n: Float64s
    distances_m: Float64s


def contact_along_rays(field: ForceField, starts_m: ArrayLike, ends_m: ArrayLike, reading: str = "first") -> Contact:
    """Follow straight rays through a field.

    InvalidArgument if a point is not finite, the shapes do not fit, the reading is unknown, or rays and steps are
    too many.

    Parameters
    ----------
    field : ForceField
    starts_m, ends_m : float [..., 3]
        Of each ray, in the metres of the field, of shapes that broadcast: one start is a camera, many a plane.
    reading : {"first", "peak"}

    Returns
    -------
    Contact
        Of the shape of the rays.
    """
    if reading not in READINGS:
        raise InvalidArgument("reading", repr(reading), f"one of {', '.join(READINGS)}")
    begin, end = (np.asarray(p, np.float64) for p in (starts_m, ends_m))
    try:
        shape = np.broadcast_shapes(begin.shape, end.shape)
    except ValueError:
        raise InvalidArgument("rays", f"shapes {begin.shape} and {end.shape}", "one shape [..., 3]") from None
    if not shape or shape[-1] != 3 or not math.prod(shape):
        raise InvalidArgument("rays", f"shape {shape}", "[..., 3], at least one")
    if not (np.isfinite(begin).all() and np.isfinite(end).all()):
        raise InvalidArgument("rays", "a point that is not finite", "metres")
    begin, end = (np.broadcast_to(p, shape).reshape(-1, 3) for p in (begin, end))
    longest = float(np.sqrt(((end - begin) ** 2).sum(axis=1)).max())
    steps = longest / (min(field.grid.spacing_m) / 2)
    if steps * len(begin) > MOST_LOOKUPS:
        raise InvalidArgument(
            "rays", f"{len(begin)} rays of {steps:.3g} steps", f"up to {MOST_LOOKUPS} steps in all",
            "Take fewer pixels, or shorter rays.",
        )  # fmt: skip
    looked_at = np.linspace(0.0, 1.0, 1 + math.ceil(steps))
    found, at = np.full(len(begin), np.nan), np.full(len(begin), np.nan)
    for b in range(0, len(begin), _RAYS):
        some = slice(b, b + _RAYS)
        found[some], at[some] = _followed(field, begin[some], end[some], looked_at, reading == "first")
    lengths = np.sqrt(((end - begin) ** 2).sum(axis=1))
    return Contact(found.reshape(shape[:-1]), (at * lengths).reshape(shape[:-1]))


def contact_along_axis(field: ForceField, axis: int = 2, from_low: bool = True, reading: str = "first") -> Contact:
    """Follow the columns of the lattice along x, y or z, from their low or their high end.

    Parameters
    ----------
    field : ForceField
    axis : int
        0, 1 or 2. In the axes of a camera the line of sight is z, from its low end.
    from_low : bool
    reading : {"first", "peak"}

    Returns
    -------
    Contact
        Of the shape of the other two axes, in order; distances from the first sample of the column.
    """
    if axis not in (0, 1, 2):
        raise InvalidArgument("axis", f"{axis}", "0, 1 or 2")
    grid = field.grid
    across = [np.arange(n) if a != axis else np.zeros(1, np.int64) for a, n in enumerate(grid.shape)]
    low = np.stack(np.meshgrid(*across, indexing="ij"), axis=-1)
    high = low.copy()
    high[..., axis] = grid.shape[axis] - 1
    ends = (grid.to_m(low), grid.to_m(high)) if from_low else (grid.to_m(high), grid.to_m(low))
    met = contact_along_rays(field, ends[0], ends[1], reading)
    return Contact(met.amplitudes_n.squeeze(axis), met.distances_m.squeeze(axis))


def _followed(
    field: ForceField, begin: Float64s, end: Float64s, looked_at: Float64s, first: bool
) -> tuple[Float64s, Float64s]:
    """|F| and the share of the way, float64 [n] each, NaN where there is none."""
    low, across = field.grid.to_index(begin), (end - begin) / np.asarray(field.grid.spacing_m)
    found, at = np.full(len(begin), np.nan), np.full(len(begin), np.nan)
    open_ = np.arange(len(begin))
    for share in looked_at.tolist():
        # ties to the lower sample, but for what rounding leaves of a column of the lattice
        index = np.ceil(low[open_] + share * across[open_] - 0.5 - 1e-9).astype(np.int64)
        amplitudes = _amplitudes_at(field, index)
        better = amplitudes > (0.0 if first else np.nan_to_num(found[open_]))
        found[open_[better]], at[open_[better]] = amplitudes[better], share
        if first:
            open_ = open_[~better]
            if not len(open_):
                break
    return found, at


def _amplitudes_at(field: ForceField, index: Int64s) -> Float64s:
    """|F| at lattice points, newtons, float64 [n], of int64 [n, 3]; 0 outside the grid."""
    found = np.zeros(len(index))
    inside = ((index >= 0) & (index < field.grid.shape)).all(axis=1)
    if not len(field.bricks) or not inside.any():
        return found
    places = index[inside]
    keys, wanted = brick_keys(field.grid, field.bricks), brick_keys(field.grid, places // BRICK)
    slot = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    x, y, z = (places % BRICK).T
    forces = field.forces_n[slot, x, y, z].astype(np.float64)
    found[inside] = np.where(keys[slot] == wanted, np.sqrt((forces**2).sum(axis=1)), 0.0)
    return found


LEAST_BLOCKS: Final = 16
BLOCK_LENGTHS: Final = 4
"""Side of a block over the correlation length of both."""

MOST_SHUFFLES: Final = 1 << 20


@dataclass(frozen=True)
class Correlation:
    """Information of a picture about a haptic medium.

    Attributes
    ----------
    mutual : Quantity
        I(V;A), bits a pixel.
    null_mean_bits, null_spread_bits : float
        Mean and standard deviation of I over the shuffles.
    z : float
        (I - mean) / standard deviation; NaN where the shuffles do not differ.
    p : float
        Share of the shuffles, with the picture itself as one of them, whose I is no less: 1 / (shuffles + 1) at best.
    shuffles : int
    block_px : int
        Side of a block.
    blocks : int
        How many were shuffled.
    share : float
        Of all pixels, those where both are known, within whole blocks.
    """

    mutual: Quantity
    null_mean_bits: float
    null_spread_bits: float
    z: float
    p: float
    shuffles: int
    block_px: int
    blocks: int
    share: float

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs; NaN becomes None."""
        return {
            "mutual": self.mutual.summary(),
            "null_mean_bits": self.null_mean_bits,
            "null_spread_bits": self.null_spread_bits,
            "z": None if math.isnan(self.z) else self.z,
            "p": self.p,
            "shuffles": self.shuffles,
            "block_px": self.block_px,
            "blocks": self.blocks,
            "share": self.share,
        }


def picture_correlation(
    picture: ArrayLike,
    touched: ArrayLike,
    *,
    classes: int = 8,
    shuffles: int = 199,
    block_px: int | None = None,
    estimator: str = "miller-madow",
    interval: bool = True,
    seed: int = 0,
) -> Correlation:
    """I(V;A) of a picture and a haptic medium, with a test against chance.

    InvalidArgument if the shapes differ, no pixel or fewer than four blocks hold both, or an option is out of
    range.

    Parameters
    ----------
    picture : float [height, width]
        Luma, depth in metres, or any other number a pixel; NaN where unknown.
    touched : float [height, width]
        |F| in newtons, or another number of the medium; NaN where there is none.
    classes : int
        Of equal shares, for each of the two, 2 to 256; equal values stay together.
    shuffles : int
        Of blocks, 19 or more.
    block_px : int, optional
        Side of a block; see the module.
    estimator : str
        One of `touchfield.measure.estimators.ESTIMATORS`, of I and of its null. Plug-in is high by about
        (classes - 1)^2 / (2 n ln 2) bits, which z and p do not feel.
    interval : bool
        Whether I gets one, of a bootstrap over groups of these blocks.
    seed : int
        Of the shuffles.
    """
    v, a = _maps(picture, touched)
    if not 2 <= classes <= 256:
        raise InvalidArgument("classes", f"{classes}", "2 to 256")
    if not 19 <= shuffles <= MOST_SHUFFLES:
        raise InvalidArgument("shuffles", f"{shuffles}", f"19 to {MOST_SHUFFLES}")
    block, notes = _block_side(v, a, block_px)
    x, y = (_in_blocks(classes_of_equal_share(m, classes), block) for m in (v, a))
    both = (x >= 0) & (y >= 0)
    if int(both.any(axis=1).sum()) < 4:
        found = f"{int(both.any(axis=1).sum())} blocks of {block} pixels with both known"
        raise InvalidArgument("picture", found, "4 or more", "Give a smaller block_px, or larger pictures.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)  # its note tells
        blocks = max(8, min(64, len(x)))
        mutual = mutual_information(x[both], y[both], estimator=estimator, interval=interval, blocks=blocks)
    rng = np.random.default_rng(seed)
    null = np.array([_bits(x, y[rng.permutation(len(y))], classes, estimator) for _ in range(shuffles)])
    value, mean, spread = float(mutual), float(null.mean()), float(null.std(ddof=1))
    no_less = int((null >= value - 1e-12).sum())
    notes += (f"{classes} classes of equal share each",)
    return Correlation(
        mutual.of(name="I(V;A)", quantiser=f"{classes} classes of equal share", notes=(*mutual.notes, *notes)),
        mean,
        spread,
        (value - mean) / spread if spread > 0 else math.nan,
        (1 + no_less) / (1 + shuffles),
        shuffles,
        block,
        len(x),
        float(both.sum() / v.size),
    )


def classes_of_equal_share(values: ArrayLike, count: int) -> Int64s:
    """The class of each value, 0 .. count - 1, of about equal shares; -1 where NaN, int64 of the same shape.

    Equal values are of one class, that of the middle of their ranks.
    """
    given = np.asarray(values, np.float64)
    known = ~np.isnan(given)
    found, place, times = np.unique(given[known], return_inverse=True, return_counts=True)
    middle = np.cumsum(times) - times / 2
    made = np.full(given.shape, -1, np.int64)
    if len(found):
        of_value = np.minimum((middle / times.sum() * count).astype(np.int64), count - 1)
        made[known] = of_value[place.reshape(-1)]
    return made


def correlation_length_px(first: ArrayLike, second: ArrayLike) -> float:
    """The shift at which the product of the autocorrelations of two pictures falls to 1/e, pixels, of the worse axis.

    Unknown pixels (NaN) count as the mean. 0 where one of them does not vary; a whole side where it never falls so
    far.
    """
    maps = [np.asarray(m, np.float64) for m in (first, second)]
    longest = 0.0
    for axis in (0, 1):
        product = np.prod([_autocorrelation(m, axis) for m in maps], axis=0)
        if not product[0] > 0:
            return 0.0
        below = np.flatnonzero(product < 1 / math.e)
        longest = max(longest, float(below[0]) if len(below) else float(len(product)))
    return longest


def _autocorrelation(values: Float64s, axis: int) -> Float64s:
    """Along one axis, of shifts from 0 on, float64 [side], 1 for no shift; all 0 where nothing varies."""
    known = ~np.isnan(values)
    side = values.shape[axis]
    if not known.any() or np.ptp(values[known]) == 0:
        return np.zeros(side)
    centred = np.where(known, values - values[known].mean(), 0.0)
    spectrum = np.abs(np.fft.rfft(centred, 2 * side, axis=axis)) ** 2
    products = np.fft.irfft(spectrum.sum(axis=1 - axis), 2 * side)[:side]
    of_pairs: Float64s = np.clip(products / np.arange(side, 0, -1) * side / products[0], 0.0, None)
    return of_pairs


def _maps(picture: ArrayLike, touched: ArrayLike) -> tuple[Float64s, Float64s]:
    maps = []
    for name, values in (("picture", picture), ("touched", touched)):
        given = np.asarray(values)
        if given.ndim != 2 or given.dtype.kind not in "biuf" or not given.size:
            raise InvalidArgument(name, f"{given.dtype} {given.shape}", "one number a pixel, [height, width]")
        maps.append(given.astype(np.float64))
        if np.isinf(maps[-1]).any():
            raise InvalidArgument(name, "infinity", "finite numbers, NaN where unknown")
    if maps[0].shape != maps[1].shape:
        raise InvalidArgument("touched", f"shape {maps[1].shape}", f"{maps[0].shape}, as of the picture")
    if (np.isnan(maps[0]) | np.isnan(maps[1])).all():
        raise InvalidArgument("picture", "no pixel where both are known", "pictures of the same scene")
    return maps[0], maps[1]


def _block_side(v: Float64s, a: Float64s, asked_px: int | None) -> tuple[int, tuple[str, ...]]:
    """The side of a block, and what is to be said of it."""
    if asked_px is not None:
        if not 1 <= asked_px <= min(v.shape):
            raise InvalidArgument("block_px", f"{asked_px}", f"1 to {min(v.shape)}, the shorter side")
        return asked_px, ()
    length = correlation_length_px(v, a)
    wanted = 1
    while wanted < BLOCK_LENGTHS * length:
        wanted *= 2
    block = wanted
    while block > 1 and (v.shape[0] // block) * (v.shape[1] // block) < LEAST_BLOCKS:
        block //= 2
    if block == wanted:
        return block, ()
    note = f"blocks of {block} pixels for a correlation length of {length:.3g}: p is too small, and z too large"
    return block, (note,)


def _in_blocks(symbols: Int64s, side: int) -> Int64s:
    """The pixels of each whole block, int64 [blocks, side^2]; what is left at the far borders is left out."""
    rows, columns = (n // side for n in symbols.shape)
    whole = symbols[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return np.ascontiguousarray(whole.transpose(0, 2, 1, 3)).reshape(rows * columns, side * side)


def _bits(x: Int64s, y: Int64s, classes: int, estimator: str) -> float:
    """I of the pixels where both are known, bits; 0 without any."""
    both = (x >= 0) & (y >= 0)
    if not both.any():
        return 0.0
    table = np.bincount(x[both] * classes + y[both], minlength=classes * classes).reshape(classes, classes)
    x_bits, y_bits, joint = (estimate_bits(n, estimator) for n in (table.sum(axis=1), table.sum(axis=0), table))
    bits = math.fsum((x_bits, y_bits, -joint))
    return max(0.0, bits) if estimator == "plug-in" else bits
