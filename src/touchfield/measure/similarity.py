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

The test against chance compares I with that of surrogates, which have the spatial correlation of one of the
two pictures and nothing else in common with it: random phases in its Fourier spectrum (J. Theiler, S. Eubank,
A. Longtin, B. Galdrikian and J. D. Farmer, Testing for nonlinearity in time series: the method of surrogate
data, Physica D 58, 1992). The picture is mirrored at its borders before, lest its opposite borders count as
neighbours, and its values are replaced by those of a normal distribution of the same order. If the picture
holds fewer than `MIN_PATCHES` squares of the correlation length, p is refused, because the surrogates of very
smooth pictures vary too little. `bench/bench_correlation.py` measures false alarms, also of the shuffling of
blocks. A trend across both pictures is dependence in the sense of this test.
"""

from __future__ import annotations

import lzma
import math
import warnings
from collections.abc import Iterator
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


MIN_PATCHES: Final = 25
"""Minimum number of squares of the correlation length in a picture; with fewer, p is refused."""

_GROUPS: Final = 8, 64  # of pixels, for the interval of I
MAX_SURROGATES: Final = 1 << 20
_ESTIMATOR: Final = "miller-madow"  # plug-in is high by about (classes - 1)^2 / (2 n ln 2) bits


@dataclass(frozen=True)
class Correlation(Report):
    """Information of a picture about a haptic medium.

    `mutual`: I(V;A), bits per pixel. `null_mean_bits`, `null_spread_bits`: mean and standard deviation of I
    over the surrogates. `z`: (I - mean) / standard deviation; NaN if the surrogates do not differ. `p`:
    fraction of the surrogates, including the picture itself, whose I is no less. `z` and `p` are NaN if the
    picture is too smooth for a test. `length_px`: correlation length of both pictures. `share`: fraction of
    all pixels where both are known.
    """

    mutual: Quantity
    null_mean_bits: float
    null_spread_bits: float
    z: float
    p: float
    surrogates: int
    length_px: float
    share: float


def picture_correlation(
    picture: ArrayLike,
    touched: ArrayLike,
    *,
    classes: int = 8,
    surrogates: int = 199,
    interval: bool = True,
    seed: int = 0,
) -> Correlation:
    """I(V;A) of a picture and a haptic medium, with a test against chance.

    `picture` float [height, width]: luma, depth in metres, or any other number per pixel. `touched`, of the
    same shape: |F| in newtons, or another number of the medium. NaN if unknown or none. `classes`: number of
    classes of equal frequency for each of the two, 2 to 256; equal values stay in one class. `surrogates`:
    number of surrogates, 19 or more. `interval`: whether I gets one, over square groups of pixels. `seed`: of
    the surrogates. InvalidArgument if the shapes differ, fewer than four groups of pixels hold both, or an
    option is out of range.
    """
    v, a = _maps(picture, touched)
    require_between(2, 256, classes=classes)
    require_between(19, MAX_SURROGATES, surrogates=surrogates)
    x, y = (quantile_classes(m, classes) for m in (v, a))
    mutual = _mutual(x, y, interval)
    notes: tuple[str, ...] = (f"{classes} classes of equal share each",)
    if np.isnan(v).sum() > np.isnan(a).sum():  # surrogates of the one of which more is known
        v, x, y = a, y, x
    drawn = phase_surrogates(v, surrogates, seed)
    null = np.array([_bits(quantile_classes(other, classes), y, classes) for other in drawn])
    value, mean, spread = float(mutual), float(null.mean()), float(null.std(ddof=1))
    both, length_px = (x >= 0) & (y >= 0), correlation_length_px(picture, touched)
    patches = both.sum() / length_px**2 if length_px else math.inf
    z = (value - mean) / spread if spread > 0 else math.nan
    p = (1 + int((null >= value - 1e-12).sum())) / (1 + surrogates)
    if patches < MIN_PATCHES:
        z = p = math.nan
        found = (
            f"the pictures hold {patches:.3g} squares of their correlation length of {length_px:.3g} pixels"
        )
        notes = (f"no p and no z: {found}, and a test needs {MIN_PATCHES}", *notes)
    mutual = mutual.of(
        name="I(V;A)", quantiser=f"{classes} classes of equal share", notes=(*mutual.notes, *notes)
    )
    return Correlation(mutual, mean, spread, z, p, surrogates, length_px, float(both.mean()))


def _mutual(x: Int64s, y: Int64s, interval: bool) -> Quantity:
    """Return I of two pictures of classes, -1 where unknown; the interval is over square groups of pixels."""
    side = max(1, math.isqrt(x.size // _GROUPS[1]))
    grouped = [_in_groups(symbols, side) for symbols in (x, y)]
    both = (grouped[0] >= 0) & (grouped[1] >= 0)
    if int(both.any(axis=1).sum()) < 4:
        found = f"{int(both.any(axis=1).sum())} groups of {side} x {side} pixels with both known"
        raise InvalidArgument("picture", found, "4 or more", "Give larger pictures, or look at the medium.")
    groups = max(_GROUPS[0], min(_GROUPS[1], len(both)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)  # reported in its note
        return mutual_information(
            grouped[0][both], grouped[1][both], estimator=_ESTIMATOR, interval=interval, blocks=groups
        )


def phase_surrogates(values: ArrayLike, count: int, seed: int = 0) -> Iterator[Float64s]:
    """Yield pictures with the spatial correlation of one and random phases, float64 of its shape.

    `values` float [height, width]: NaN where unknown, and there in the surrogates. Their values are about
    normal; the correlation is that of the ranks. Unknown pixels take the value of the nearest known one.
    """
    from scipy.ndimage import distance_transform_edt
    from scipy.special import ndtri
    from scipy.stats import rankdata

    numbers, rng = np.asarray(values, np.float64), np.random.default_rng(seed)
    is_unknown = np.isnan(numbers)
    if is_unknown.any():
        nearest = distance_transform_edt(is_unknown, return_distances=False, return_indices=True)
        numbers = numbers[tuple(nearest)]
    normal = ndtri((rankdata(numbers).reshape(numbers.shape) - 0.5) / numbers.size)
    mirrored = np.pad(normal, [(0, side) for side in normal.shape], mode="symmetric")
    amplitudes = np.abs(np.fft.rfft2(mirrored - mirrored.mean()))
    height, width = normal.shape
    for _ in range(count):
        noise = np.fft.rfft2(rng.normal(size=mirrored.shape))
        phases = noise / np.maximum(np.abs(noise), 1e-300)
        drawn = np.fft.irfft2(amplitudes * phases, mirrored.shape)[:height, :width]
        yield np.where(is_unknown, np.nan, drawn)


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

    Pixels, the larger of both axes, over the pairs of known pixels (not NaN). The result is 0 if one of the
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
    sums, pairs = (
        np.fft.irfft((np.abs(np.fft.rfft(m, 2 * side, axis=axis)) ** 2).sum(axis=1 - axis), 2 * side)[:side]
        for m in (centred, is_known.astype(np.float64))
    )
    means = np.divide(sums, pairs, out=np.zeros(side), where=pairs > 0.5)  # pairs are whole numbers
    correlation: Float64s = np.clip(means / means[0], 0.0, None)
    return correlation


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


def _in_groups(symbols: Int64s, side: int) -> Int64s:
    """Return the pixels of each square, int64 [squares, side^2]; -1 beyond the picture."""
    rows, columns = (-(-n // side) for n in symbols.shape)
    beyond = [(0, rows * side - symbols.shape[0]), (0, columns * side - symbols.shape[1])]
    padded = np.pad(symbols, beyond, constant_values=-1).reshape(rows, side, columns, side)
    return np.ascontiguousarray(padded.transpose(0, 2, 1, 3)).reshape(rows * columns, side * side)


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
