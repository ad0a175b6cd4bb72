"""How alike two haptic media are, and how much a picture tells of one (paper section 4: "similarity
estimation", "correlation analysis between haptic media and visual media"). The paper names no measure of
either.

Two quantised media S and T on one lattice:

===================  ==========================================  ==================================================
measure              compares                                    metric
===================  ==========================================  ==================================================
NMI                  symbols voxel by voxel                      no
VI                   symbols voxel by voxel                      yes, over "voxel"
sqrt(JSD)            histograms of the symbols, wherever         yes, over either
                     they lie
NCD                  what one medium tells a compressor of the   no; see `compression_distance`
                     other, at any shift
===================  ==========================================  ==================================================

"Metric" is said of the plug-in estimates, and holds up to what a measure cannot see: VI and NMI are blind to
another name for each symbol, and sqrt(JSD) to where symbols lie. Over "object", NMI and VI look at the voxels
where one of the two has a force; that set differs from pair to pair, and the triangle inequality no longer
holds.

A picture: I(V;A), V the luma or depth of a pixel, A the |F| that a hand meets along the pixel's ray, both in
classes of equal shares, mu uniform over the pixels where both are known. A pixel whose ray meets nothing is
left out, so that the outline of a body alone makes no correlation. *Is it chance?* Pixels depend on their
neighbours, so that whole square blocks of the second picture are shuffled (P. Good, Permutation, Parametric,
and Bootstrap Tests of Hypotheses, 2005). They must be larger than the distance over which both are like
themselves: by default their side is the smallest power of two of at least four times the shift at which the
product of their autocorrelations (M. S. Bartlett, 1946) falls to 1/e. Where the picture does not hold 16 such
blocks a smaller one is taken, and a note says that p is then too small. Dependence across the borders of
blocks is lost in any case: of 60 pairs of independent pictures (64 x 64, smoothed by 1.5 pixels) 7 % had p <=
0.05. A trend across both is dependence in the sense of this test.
"""

from __future__ import annotations

import lzma
import math
import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import InvalidArgument, require_between, require_one_of
from touchfield.measure.counts import ABSENT
from touchfield.measure.estimators import estimate_bits
from touchfield.measure.field_count import field_counts, supported
from touchfield.measure.field_symbols import Fields, Frames
from touchfield.measure.information import (
    jensen_shannon_distance,
    mutual_information,
    normalised_mutual_information,
    variation_of_information,
)
from touchfield.measure.quantity import FewSamplesWarning, Quantity, Told
from touchfield.medium.field import brick_keys, numbers_of, values_at
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from touchfield.medium import ForceField


MOST_BYTES: Final = 1 << 25
"""Of the packed symbols of both media; lzma takes about twelve times as much memory."""

_COUNT_BYTES: Final = 8
_MENDS: Final = (
    "Resample one onto the lattice of the other (touchfield.filters.resample), then quantise both.",
    "Fit one quantiser to both media at once.",
)
_NOT_A_METRIC: Final = "not a metric: NCD(x,x) is not 0, and the triangle inequality holds only nearly"


def compression_distance(first: Fields, second: Fields) -> Quantity:
    """NCD of two media of one lattice and one Q, by lzma; about 0 for equal ones, about 1 for unrelated ones.

    `first`, `second`: FieldSymbols or sequences of them, each frame asked for once; they may differ in
    length. Gives "NCD(S,T)", unit "1", mu "voxel". InvalidArgument if lattice or Q differ, or both together
    take more than 32 MiB when packed.
    """
    a, b = Frames(first, "first"), Frames(second, "second")
    a.check_like(b, "second", "the first", _MENDS)
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

    For each frame the number of bricks that hold a force, the place of each as the distance from the one
    before it, and its 512 symbols, in whole bytes, the low bytes of a brick before the high ones.

    InvalidArgument if there are more than `most_bytes`.
    """
    width = max(1, -(-(frames.alphabet - 1).bit_length() // 8))
    parts: list[bytes] = []
    total = 0
    for n in range(frames.count):
        field = frames.take(n)
        is_held = field.symbols.any(axis=(1, 2, 3))
        total += _COUNT_BYTES + int(is_held.sum()) * (_COUNT_BYTES + BRICK**3 * width)
        if total > most_bytes:
            raise InvalidArgument(
                "symbols to compress", f"more than {MOST_BYTES >> 20} MiB of both media",
                f"up to {MOST_BYTES >> 20} MiB", "Take fewer frames, a coarser lattice, or no NCD.",
            )  # fmt: skip
        keys = brick_keys(field.grid, field.bricks[is_held])
        symbols = field.symbols[is_held].reshape(len(keys), BRICK**3).astype("<u4")
        planes = symbols.view(np.uint8).reshape(len(keys), BRICK**3, 4)[:, :, :width].transpose(0, 2, 1)
        parts += [
            len(keys).to_bytes(_COUNT_BYTES, "little"),
            np.diff(keys, prepend=0).astype("<u8").tobytes(),
        ]
        parts.append(planes.tobytes())
    return b"".join(parts)


@dataclass(frozen=True)
class Similarity(Told):
    """Measures that tell two media apart; each a `Quantity`.

    `normalised` I(S;T): 1 where each symbol of one medium tells that of the other, 0 where it tells nothing.
    `variation`: VI(S,T), bits a sample. `jensen_shannon`: sqrt(JSD) between the histograms of symbols, 0
    to 1. `compression`: NCD, about 0 to 1; None where it was not asked for.
    """

    normalised: Quantity
    variation: Quantity
    jensen_shannon: Quantity
    compression: Quantity | None


def similarity(
    first: Fields, second: Fields, over: str = "voxel", *, compressed: bool = True, interval: bool = True
) -> Similarity:
    """Compare two media of one lattice and one Q, by plug-in counts: the bias-corrected estimates are no
    metrics.

    `first`, `second`: FieldSymbols or sequences of as many, S and T, compared frame by frame. "One Q" means
    that a symbol is the same codeword in both: a quantiser that is fitted to data is to be fitted to both.
    Each frame is asked for at most twice, and once more for the NCD. `over`: mu of NMI and VI, "voxel" for
    all voxels or "object" for those where one of the two has a force; sqrt(JSD) over "object" compares the
    symbols of the forces of each medium. `compressed`: whether to make the NCD, which takes the longest.
    `interval`: whether the others get one, of 27 parts of space. InvalidArgument if the media differ in
    lattice, Q or length, an option is unknown, over "object" one of them has no force, or the symbols are too
    many to compress.
    """
    Frames(first, "first").check_like(Frames(second, "second"), "second", "the first", _MENDS)
    counts = supported(field_counts(first, second, (over,), interval=interval)[over])
    apart = jensen_shannon_distance(counts, absent=0 if over == "object" else ABSENT)
    if math.isnan(apart.value):
        supported(replace(counts, cells=counts.cells[:0], weights=counts.weights[:0]))
    compression = compression_distance(first, second) if compressed else None
    return Similarity(
        normalised_mutual_information(counts), variation_of_information(counts), apart, compression
    )


# -- a picture and a medium


READINGS: Final = ("first", "peak")
MOST_LOOKUPS: Final = 1 << 31
_RAYS = 1 << 16  # at a time


@dataclass(frozen=True)
class Contact:
    """Points that rays meet first.

    `amplitudes_n` float64 [...]: |F|, newtons; NaN where a ray meets no force. `distances_m` float64 [...]:
    from the start of the ray to that sample's step, metres; NaN likewise.
    """

    amplitudes_n: Float64s
    distances_m: Float64s


def contact_along_rays(
    field: ForceField, starts_m: ArrayLike, ends_m: ArrayLike, reading: str = "first"
) -> Contact:
    """Follow straight rays through a field, to the first force or to the greatest.

    `starts_m`, `ends_m` float [..., 3]: of each ray, in the metres of the field, of shapes that broadcast:
    one start is a camera, many a plane. `reading`: "first" or "peak". Gives a `Contact` of the shape of the
    rays. InvalidArgument if a point is not finite, the shapes do not fit, the reading is unknown, or rays and
    steps are too many.
    """
    require_one_of("reading", reading, READINGS)
    begin, end = (numbers_of("rays", p, is_finite=True) for p in (starts_m, ends_m))
    try:
        shape = np.broadcast_shapes(begin.shape, end.shape)
    except ValueError:
        raise InvalidArgument("rays", f"shapes {begin.shape} and {end.shape}", "one shape [..., 3]") from None
    if not shape or shape[-1] != 3 or not math.prod(shape):
        raise InvalidArgument("rays", f"shape {shape}", "[..., 3], at least one")
    begin, end = (np.broadcast_to(p, shape).reshape(-1, 3) for p in (begin, end))
    longest = float(np.sqrt(((end - begin) ** 2).sum(axis=1)).max())
    steps = longest / (min(field.grid.spacing_m) / 2)
    if steps * len(begin) > MOST_LOOKUPS:
        raise InvalidArgument(
            "rays", f"{len(begin)} rays of {steps:.3g} steps", f"up to {MOST_LOOKUPS} steps in all",
            "Take fewer pixels, or shorter rays.",
        )  # fmt: skip
    looked_at = np.linspace(0.0, 1.0, 1 + math.ceil(steps))
    some = [slice(b, b + _RAYS) for b in range(0, len(begin), _RAYS)]
    followed = [_followed(field, begin[s], end[s], looked_at, reading == "first") for s in some]
    amplitudes, at = np.concatenate(followed, axis=1)
    lengths = np.sqrt(((end - begin) ** 2).sum(axis=1))
    return Contact(amplitudes.reshape(shape[:-1]), (at * lengths).reshape(shape[:-1]))


def _followed(
    field: ForceField, begin: Float64s, end: Float64s, looked_at: Float64s, first: bool
) -> Float64s:
    """|F| and the share of the way, float64 [2, n], NaN where there is none."""
    low, across = field.grid.to_index(begin), (end - begin) / np.asarray(field.grid.spacing_m)
    best = np.full((2, len(begin)), np.nan)
    open_ = np.arange(len(begin))
    for share in looked_at.tolist():
        # ties to the lower sample, but for what rounding leaves of a column of the lattice
        index = np.ceil(low[open_] + share * across[open_] - 0.5 - 1e-9).astype(np.int64)
        forces = values_at(field.grid, field.bricks, field.forces_n, index).astype(np.float64)
        amplitudes = np.sqrt((forces**2).sum(axis=1))
        better = amplitudes > (0.0 if first else np.nan_to_num(best[0, open_]))
        best[0, open_[better]], best[1, open_[better]] = amplitudes[better], share
        if first:
            open_ = open_[~better]
            if not len(open_):
                break
    return best


_WHOLE_BLOCKS: Final = 16  # that a picture is to hold
BLOCK_LENGTHS: Final = 4
"""Side of a block over the correlation length of both."""

MOST_SHUFFLES: Final = 1 << 20
_ESTIMATOR: Final = "miller-madow"  # plug-in is high by about (classes - 1)^2 / (2 n ln 2) bits


@dataclass(frozen=True)
class Correlation(Told):
    """Information of a picture about a haptic medium.

    `mutual`: I(V;A), bits a pixel. `null_mean_bits`, `null_spread_bits`: mean and standard deviation of I
    over the shuffles. `z`: (I - mean) / standard deviation; NaN where the shuffles do not differ. `p`: share
    of the shuffles, with the picture itself as one of them, whose I is no less. `block_px`: side of a block;
    `blocks`: how many were shuffled. `share`: of all pixels, those where both are known, within whole blocks.
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


def picture_correlation(
    picture: ArrayLike,
    touched: ArrayLike,
    *,
    classes: int = 8,
    shuffles: int = 199,
    block_px: int | None = None,
    interval: bool = True,
    seed: int = 0,
) -> Correlation:
    """I(V;A) of a picture and a haptic medium, with a test against chance.

    `picture` float [height, width]: luma, depth in metres, or any other number a pixel; `touched`, alike: |F|
    in newtons, or another number of the medium; NaN where unknown or none. `classes`: of equal shares, for
    each of the two, 2 to 256; equal values stay together. `shuffles`: of blocks, 19 or more. `block_px`: side
    of a block, see the module. `interval`: whether I gets one, over groups of these blocks. `seed`: of the
    shuffles. InvalidArgument if the shapes differ, no pixel or fewer than four blocks hold both, or an option
    is out of range.
    """
    v, a = _maps(picture, touched)
    require_between(2, 256, classes=classes)
    require_between(19, MOST_SHUFFLES, shuffles=shuffles)
    block, notes = _block_side(v, a, block_px)
    x, y = (_in_blocks(classes_of_equal_share(m, classes), block) for m in (v, a))
    both = (x >= 0) & (y >= 0)
    if int(both.any(axis=1).sum()) < 4:
        found = f"{int(both.any(axis=1).sum())} blocks of {block} pixels with both known"
        raise InvalidArgument("picture", found, "4 or more", "Give a smaller block_px, or larger pictures.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)  # its note tells
        blocks = max(8, min(64, len(x)))
        mutual = mutual_information(x[both], y[both], estimator=_ESTIMATOR, interval=interval, blocks=blocks)
    rng = np.random.default_rng(seed)
    null = np.array([_bits(x, y[rng.permutation(len(y))], classes) for _ in range(shuffles)])
    value, mean, spread = float(mutual), float(null.mean()), float(null.std(ddof=1))
    no_less = int((null >= value - 1e-12).sum())
    notes += (f"{classes} classes of equal share each",)
    return Correlation(
        mutual.of(
            name="I(V;A)", quantiser=f"{classes} classes of equal share", notes=(*mutual.notes, *notes)
        ),
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
    from scipy.stats import rankdata

    numbers = np.asarray(values, np.float64)
    known = ~np.isnan(numbers)
    middle = rankdata(numbers[known]) - 0.5
    classes = np.full(numbers.shape, -1, np.int64)
    classes[known] = np.minimum(middle / max(1, len(middle)) * count, count - 1)
    return classes


def correlation_length_px(first: ArrayLike, second: ArrayLike) -> float:
    """The shift at which the product of the autocorrelations of two pictures falls to 1/e, pixels, of the
    worse axis.

    Unknown pixels (NaN) count as the mean. 0 where one of them does not vary; a whole side where it never
    falls so far.
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
        numbers = np.asarray(values)
        if numbers.ndim != 2 or numbers.dtype.kind not in "biuf" or not numbers.size:
            raise InvalidArgument(
                name, f"{numbers.dtype} {numbers.shape}", "one number a pixel, [height, width]"
            )
        maps.append(numbers.astype(np.float64))
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
    while block > 1 and (v.shape[0] // block) * (v.shape[1] // block) < _WHOLE_BLOCKS:
        block //= 2
    if block == wanted:
        return block, ()
    note = (
        f"blocks of {block} pixels for a correlation length of {length:.3g}: p is too small, and z too large"
    )
    return block, (note,)


def _in_blocks(symbols: Int64s, side: int) -> Int64s:
    """The pixels of each whole block, int64 [blocks, side^2]; what is left at the far borders is left out."""
    rows, columns = (n // side for n in symbols.shape)
    whole = symbols[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return np.ascontiguousarray(whole.transpose(0, 2, 1, 3)).reshape(rows * columns, side * side)


def _bits(x: Int64s, y: Int64s, classes: int) -> float:
    """I of the pixels where both are known, bits; 0 without any."""
    both = (x >= 0) & (y >= 0)
    if not both.any():
        return 0.0
    table = np.bincount(x[both] * classes + y[both], minlength=classes * classes).reshape(classes, classes)
    x_bits, y_bits, joint = (
        estimate_bits(n, _ESTIMATOR) for n in (table.sum(axis=1), table.sum(axis=0), table)
    )
    return math.fsum((x_bits, y_bits, -joint))
