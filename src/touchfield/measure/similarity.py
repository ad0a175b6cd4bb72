"""Measures how similar two haptic media are, and how much the brightness of a picture tells about the forces
of its scene.

The paper (section 4) names "similarity estimation" and "correlation analysis between haptic media and visual
media" without a measure of either.

Two quantised media S and T on one lattice:

===================  ==========================================  ========================================
measure              compares                                    metric
===================  ==========================================  ========================================
NMI                  symbols voxel by voxel                      no
VI                   symbols voxel by voxel                      yes, over "voxel"
sqrt(JSD)            histograms of the symbols, regardless of    yes, over either
                     position
NCD                  how much one medium helps a compressor      no; see `compression_distance`
                     with the other, at any shift
===================  ==========================================  ========================================

"Metric" refers to the plug-in estimates, up to differences that a measure ignores: VI and NMI ignore a
renaming of the symbols, and sqrt(JSD) ignores where symbols lie. Over "object", NMI and VI use the voxels
where one of the two has a force; that set differs from pair to pair, and the triangle inequality no longer
holds.

A picture is compared by I(V;A). V is the luma or depth of a pixel, and A the |F| that a hand meets along the
pixel's ray, both in classes of equal frequency; mu is uniform over the pixels where both are known. A pixel
whose ray meets nothing is omitted, so that the outline of a body alone causes no correlation.

The test against chance shuffles whole square blocks of the second picture, because pixels depend on their
neighbours (P. Good, Permutation, Parametric, and Bootstrap Tests of Hypotheses, 2005). Blocks must be larger
than the distance over which both pictures are correlated with themselves: by default their side is the
smallest power of two of at least four times the shift at which the product of their autocorrelations (M. S.
Bartlett, 1946) falls to 1/e. If the picture does not hold 16 such blocks, smaller ones are used, and a note
says that p is then too small. Dependence across the borders of blocks is lost in any case: of 60 pairs of
independent pictures (64 x 64, smoothed by 1.5 pixels) 7 % had p <= 0.05. A trend across both pictures is
dependence in the sense of this test.
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
from touchfield.measure.quantity import FewSamplesWarning, Quantity, Report
from touchfield.medium.field import brick_keys, numbers_of, values_at
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from touchfield.medium import ForceField


MAX_BYTES: Final = 1 << 25
"""Maximum size of the packed symbols of both media; lzma needs about twelve times as much memory."""

_COUNT_BYTES: Final = 8
_MENDS: Final = (
    "Resample one onto the lattice of the other (touchfield.filters.resample), then quantise both.",
    "Fit one quantiser to both media at once.",
)
_NOT_A_METRIC: Final = "not a metric: NCD(x,x) is not 0, and the triangle inequality holds only nearly"


def compression_distance(first: Fields, second: Fields) -> Quantity:
    """Return the normalised compression distance (NCD) of two media by lzma.

    It is about 0 for equal media and about 1 for unrelated ones. `first`, `second`: FieldSymbols or sequences
    of them, of one lattice and one Q; each frame is requested once; the lengths may differ. Returns
    "NCD(S,T)", unit "1", mu "voxel". InvalidArgument if lattice or Q differ, or both together take more than
    32 MiB when packed.
    """
    a, b = Frames(first, "first"), Frames(second, "second")
    a.check_like(b, "second", "the first", _MENDS)
    voxels = a.grid.voxel_count * (a.count + b.count)
    first_bytes = pack(a, MAX_BYTES)
    x, y = sorted(
        [first_bytes, pack(b, MAX_BYTES - len(first_bytes))], key=lambda d: (len(d), d)
    )  # sorted, so that the distance is symmetric
    window = max(1 << 12, 1 << (len(x) + len(y)).bit_length())
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 6, "dict_size": window}]
    sizes = [len(lzma.compress(d, lzma.FORMAT_RAW, filters=filters)) for d in (x, y, x + y)]
    value = (sizes[2] - min(sizes[:2])) / max(sizes[:2])
    notes = ("C is lzma", _NOT_A_METRIC)
    return Quantity("NCD(S,T)", value, "1", a.quantiser, "voxel", "lzma", samples=voxels, notes=notes)


def pack(frames: Frames, max_bytes: int = MAX_BYTES) -> bytes:
    """Pack the symbols of all frames as bytes; equal symbols give equal bytes.

    For each frame: the number of bricks with a force, the key of each as the difference from the one before
    it, and its 512 symbols, in whole bytes, the low bytes of a brick before the high ones.

    InvalidArgument if there are more than `max_bytes`.
    """
    width = max(1, -(-(frames.alphabet - 1).bit_length() // 8))
    parts: list[bytes] = []
    total = 0
    for n in range(frames.count):
        field = frames.take(n)
        has_force = field.symbols.any(axis=(1, 2, 3))
        total += _COUNT_BYTES + int(has_force.sum()) * (_COUNT_BYTES + BRICK**3 * width)
        if total > max_bytes:
            raise InvalidArgument(
                "symbols to compress", f"more than {MAX_BYTES >> 20} MiB of both media",
                f"up to {MAX_BYTES >> 20} MiB", "Take fewer frames, a coarser lattice, or no NCD.",
            )  # fmt: skip
        keys = brick_keys(field.grid, field.bricks[has_force])
        symbols = field.symbols[has_force].reshape(len(keys), BRICK**3).astype("<u4")
        planes = symbols.view(np.uint8).reshape(len(keys), BRICK**3, 4)[:, :, :width].transpose(0, 2, 1)
        parts += [
            len(keys).to_bytes(_COUNT_BYTES, "little"),
            np.diff(keys, prepend=0).astype("<u8").tobytes(),
        ]
        parts.append(planes.tobytes())
    return b"".join(parts)


@dataclass(frozen=True)
class Similarity(Report):
    """Similarity measures of two media; each a `Quantity`.

    `normalised`: normalised I(S;T); 1 if each symbol of one medium determines that of the other, 0 for
    independent ones. `variation`: VI(S,T), bits per sample. `jensen_shannon`: sqrt(JSD) between the
    histograms of symbols, 0 to 1. `compression`: NCD, about 0 to 1; None if it was not requested.
    """

    normalised: Quantity
    variation: Quantity
    jensen_shannon: Quantity
    compression: Quantity | None


def similarity(
    first: Fields, second: Fields, over: str = "voxel", *, compressed: bool = True, interval: bool = True
) -> Similarity:
    """Compare two media of one lattice and one quantiser.

    All measures use plug-in counts, because bias-corrected estimates are no metrics. `first`, `second`:
    FieldSymbols or sequences of equal length, S and T, compared frame by frame. "One quantiser" means that a
    symbol is the same codeword in both: a quantiser that is fitted to data must be fitted to both. Each frame
    is requested at most twice, and once more for the NCD. `over`: mu of NMI and VI, "voxel" for all voxels or
    "object" for those where one of the two has a force; sqrt(JSD) over "object" compares the symbols of the
    forces of each medium. `compressed`: whether to compute the NCD, which takes the longest. `interval`:
    whether the other measures get one, from 27 parts of space. InvalidArgument if the media differ in
    lattice, Q or length, an option is unknown, over "object" one of them has no force, or the symbols are too
    many to compress.
    """
    Frames(first, "first").check_like(Frames(second, "second"), "second", "the first", _MENDS)
    counts = supported(field_counts(first, second, (over,), interval=interval)[over])
    distance = jensen_shannon_distance(counts, absent=0 if over == "object" else ABSENT)
    if math.isnan(distance.value):
        supported(replace(counts, cells=counts.cells[:0], weights=counts.weights[:0]))
    compression = compression_distance(first, second) if compressed else None
    return Similarity(
        normalised_mutual_information(counts), variation_of_information(counts), distance, compression
    )


# -- a picture and a medium


READINGS: Final = ("first", "peak")
MAX_LOOKUPS: Final = 1 << 31
_RAYS = 1 << 16  # at a time


@dataclass(frozen=True)
class Contact:
    """The points at which rays first meet a force, or the largest force.

    `amplitudes_n` float64 [...]: |F|, newtons; NaN if a ray meets no force. `distances_m` float64 [...]:
    distance from the start of the ray to the step that found the sample, metres; NaN likewise.
    """

    amplitudes_n: Float64s
    distances_m: Float64s


def contact_along_rays(
    field: ForceField, starts_m: ArrayLike, stops_m: ArrayLike, reading: str = "first"
) -> Contact:
    """Follow straight rays through a field to the first or to the largest force.

    `starts_m`, `stops_m` float [..., 3]: ends of each ray, in the metres of the field, of shapes that
    broadcast: one start is a camera, many are a plane. `reading`: "first" or "peak". Returns a `Contact` of
    the shape of the rays. InvalidArgument if a point is not finite, the shapes do not fit, the reading is
    unknown, or there are too many rays and steps.
    """
    require_one_of("reading", reading, READINGS)
    start, stop = (numbers_of("rays", p, is_finite=True) for p in (starts_m, stops_m))
    try:
        shape = np.broadcast_shapes(start.shape, stop.shape)
    except ValueError:
        raise InvalidArgument(
            "rays", f"shapes {start.shape} and {stop.shape}", "one shape [..., 3]"
        ) from None
    if not shape or shape[-1] != 3 or not math.prod(shape):
        raise InvalidArgument("rays", f"shape {shape}", "[..., 3], at least one")
    start, stop = (np.broadcast_to(p, shape).reshape(-1, 3) for p in (start, stop))
    longest = float(np.sqrt(((stop - start) ** 2).sum(axis=1)).max())
    steps = longest / (min(field.grid.spacing_m) / 2)
    if steps * len(start) > MAX_LOOKUPS:
        raise InvalidArgument(
            "rays", f"{len(start)} rays of {steps:.3g} steps", f"up to {MAX_LOOKUPS} steps in all",
            "Take fewer pixels, or shorter rays.",
        )  # fmt: skip
    fractions = np.linspace(0.0, 1.0, 1 + math.ceil(steps))
    chunks = [slice(b, b + _RAYS) for b in range(0, len(start), _RAYS)]
    followed = [_follow_rays(field, start[s], stop[s], fractions, reading == "first") for s in chunks]
    amplitudes, fraction = np.concatenate(followed, axis=1)
    lengths = np.sqrt(((stop - start) ** 2).sum(axis=1))
    return Contact(amplitudes.reshape(shape[:-1]), (fraction * lengths).reshape(shape[:-1]))


def _follow_rays(
    field: ForceField, start: Float64s, stop: Float64s, fractions: Float64s, first: bool
) -> Float64s:
    """Return |F| and the fraction of the ray where it is met, float64 [2, n].

    NaN for rays without a force.
    """
    low, across = field.grid.to_index(start), (stop - start) / np.asarray(field.grid.spacing_m)
    best = np.full((2, len(start)), np.nan)
    open_ = np.arange(len(start))
    for fraction in fractions.tolist():
        # half-way between samples the lower one is used; 1e-9 allows for rounding
        index = np.ceil(low[open_] + fraction * across[open_] - 0.5 - 1e-9).astype(np.int64)
        forces = values_at(field.grid, field.bricks, field.forces_n, index).astype(np.float64)
        amplitudes = np.sqrt((forces**2).sum(axis=1))
        better = amplitudes > (0.0 if first else np.nan_to_num(best[0, open_]))
        best[0, open_[better]], best[1, open_[better]] = amplitudes[better], fraction
        if first:
            open_ = open_[~better]
            if not len(open_):
                break
    return best


_MIN_BLOCKS: Final = 16  # minimum number of blocks in a picture
BLOCK_LENGTHS: Final = 4
"""Side of a block over the correlation length of both pictures."""

MAX_SHUFFLES: Final = 1 << 20
_ESTIMATOR: Final = "miller-madow"  # plug-in is high by about (classes - 1)^2 / (2 n ln 2) bits


@dataclass(frozen=True)
class Correlation(Report):
    """Information of a picture about a haptic medium.

    `mutual`: I(V;A), bits per pixel. `null_mean_bits`, `null_spread_bits`: mean and standard deviation of I
    over the shuffles. `z`: (I - mean) / standard deviation; NaN if the shuffles do not differ. `p`: fraction
    of the shuffles, including the picture itself, whose I is no less. `block_px`: side of a block; `blocks`:
    number of blocks that were shuffled. `share`: fraction of all pixels where both are known, within whole
    blocks.
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

    `picture` float [height, width]: luma, depth in metres, or any other number per pixel. `touched`, of the
    same shape: |F| in newtons, or another number of the medium. NaN if unknown or none. `classes`: number of
    classes of equal frequency for each of the two, 2 to 256; equal values stay in one class. `shuffles`:
    number of shuffles of blocks, 19 or more. `block_px`: side of a block, see the module. `interval`: whether
    I gets one, over groups of these blocks. `seed`: of the shuffles. InvalidArgument if the shapes differ, no
    pixel or fewer than four blocks hold both, or an option is out of range.
    """
    v, a = _maps(picture, touched)
    require_between(2, 256, classes=classes)
    require_between(19, MAX_SHUFFLES, shuffles=shuffles)
    block, notes = _block_side(v, a, block_px)
    x, y = (_in_blocks(quantile_classes(m, classes), block) for m in (v, a))
    both = (x >= 0) & (y >= 0)
    if int(both.any(axis=1).sum()) < 4:
        found = f"{int(both.any(axis=1).sum())} blocks of {block} pixels with both known"
        raise InvalidArgument("picture", found, "4 or more", "Give a smaller block_px, or larger pictures.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)  # reported in its note
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


def quantile_classes(values: ArrayLike, count: int) -> Int64s:
    """Return the quantile class of each value, 0 .. count - 1; -1 for NaN.

    int64 of the same shape. Equal values are in one class, that of the middle of their ranks.
    """
    from scipy.stats import rankdata

    numbers = np.asarray(values, np.float64)
    is_known = ~np.isnan(numbers)
    middle = rankdata(numbers[is_known]) - 0.5
    classes = np.full(numbers.shape, -1, np.int64)
    classes[is_known] = np.minimum(middle / max(1, len(middle)) * count, count - 1)
    return classes


def correlation_length_px(first: ArrayLike, second: ArrayLike) -> float:
    """Return the shift at which the product of two autocorrelations falls to 1/e.

    Pixels, the larger of both axes. Unknown pixels (NaN) count as the mean. The result is 0 if one of the
    pictures does not vary, and a whole side if the product never falls so far.
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
    """Return the autocorrelation along one axis, float64 [side].

    1 for no shift; all 0 if the values are constant.
    """
    is_known = ~np.isnan(values)
    side = values.shape[axis]
    if not is_known.any() or np.ptp(values[is_known]) == 0:
        return np.zeros(side)
    centred = np.where(is_known, values - values[is_known].mean(), 0.0)
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


def _block_side(v: Float64s, a: Float64s, requested_px: int | None) -> tuple[int, tuple[str, ...]]:
    """Return the side of a block, and notes on it."""
    if requested_px is not None:
        if not 1 <= requested_px <= min(v.shape):
            raise InvalidArgument("block_px", f"{requested_px}", f"1 to {min(v.shape)}, the shorter side")
        return requested_px, ()
    length = correlation_length_px(v, a)
    ideal = 1
    while ideal < BLOCK_LENGTHS * length:
        ideal *= 2
    block = ideal
    while block > 1 and (v.shape[0] // block) * (v.shape[1] // block) < _MIN_BLOCKS:
        block //= 2
    if block == ideal:
        return block, ()
    note = (
        f"blocks of {block} pixels for a correlation length of {length:.3g}: p is too small, and z too large"
    )
    return block, (note,)


def _in_blocks(symbols: Int64s, side: int) -> Int64s:
    """Return the pixels of each whole block, int64 [blocks, side^2].

    Partial blocks are omitted.
    """
    rows, columns = (n // side for n in symbols.shape)
    trimmed = symbols[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return np.ascontiguousarray(trimmed.transpose(0, 2, 1, 3)).reshape(rows * columns, side * side)


def _bits(x: Int64s, y: Int64s, classes: int) -> float:
    """Return I of the pixels where both are known, bits; 0 if there is none."""
    both = (x >= 0) & (y >= 0)
    if not both.any():
        return 0.0
    table = np.bincount(x[both] * classes + y[both], minlength=classes * classes).reshape(classes, classes)
    x_bits, y_bits, joint = (
        estimate_bits(n, _ESTIMATOR) for n in (table.sum(axis=1), table.sum(axis=0), table)
    )
    return math.fsum((x_bits, y_bits, -joint))
