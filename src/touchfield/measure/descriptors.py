"""Describes a haptic medium by a vector of 125 numbers, so that similar media can be found by the distance of
their vectors (paper sections 4 and 5.1).

The paper ("indexing") names no descriptor. This one has eight named parts of fixed lengths:

================  ====  ==================================================  ==============================
part              size  contents                                            invariant to
================  ====  ==================================================  ==============================
amplitude           21  sqrt of the fraction of counted voxels at each      position, pose, order of the
                        of 21 levels of |F|, Weber steps of k = 0.1 from    frames
                        0.05 N to 2.8 N and above
directions          42  sqrt of the fraction of sum |F| around each of 42   position, size, stiffness; *not*
                        icosahedral directions                              to pose
direction_power      8  sqrt(P_l), l = 1 .. 8: spherical-harmonic power of  position, size, stiffness, pose
                        the directions, weighted by |F|
shells              42  power of the spherical harmonics of the skin in     position, size, pose; nearly
                        six shells, see `touchfield.measure.shells`         stiffness
support              5  fraction of counted octree cells, levels 1 ..   position, size; pose by right
                        5 of the cube around the counted voxels         angles
level_entropy        5  entropy of the cells' classes of |F|, relative to   position, size; pose by right
                        its maximum                                         angles
change               1  |F(t + 1/30 s) - F(t)| over |F|, root mean square   position, size, stiffness, pose;
                        over the lattice, halved                            frame rate
turnover             1  of the voxels counted at t or t + 1/30 s, the       the same except stiffness
                        fraction counted at only one of the two times
================  ====  ==================================================  ==============================

Both histograms are soft: a voxel is shared between the two nearest levels, and between the directions around
it, so that a small error changes the histogram little. A voxel is *counted* if |F| is 0.05 N or more:
a filter or a coder may spread or remove weaker forces.

Invariance holds up to the lattice: a body that is rotated or scaled is sampled at other points of it.
Euclidean distances between square roots of fractions are Hellinger distances (times sqrt 2), and sqrt(P_l) is
a length, so that Euclidean distances between parts are meaningful and are metrics.

Of a medium with many frames a few are sampled, evenly spaced. Fractions are taken over all of them together;
the shells, the octree levels and the changes are means over them. Friction and damping, which are metadata,
are not described.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import EqualByValue, Float32s, Float64s, Int32s
from touchfield.errors import InvalidArgument, require_one_of
from touchfield.measure.estimators import entropy_bits
from touchfield.measure.shells import DEGREE as SHELL_DEGREE, SHELLS, harmonic_norms, shell_power
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.field import brick_keys, numbers_of
from touchfield.medium.selection import evenly_spaced
from touchfield.perception.weber import WeberLadder

if TYPE_CHECKING:
    from touchfield.medium import Grid


SPREAD: Final = 0.3
"""Width of the soft histogram of directions, radians: about half the angle between neighbouring
directions."""


class DirectionSums:
    """Sums of forces by direction and by spherical harmonic.

    `degree`: the highest degree of the harmonics, 1 or more. `by_direction` float64 [42]: sum of the
    amplitudes around each of `icosahedral_directions`, newtons. A force is shared between the directions in
    proportion to exp(cos(angle) / `SPREAD`^2), so that a small rotation moves a small part of it.
    `coefficients` float64 [(degree + 1)^2]: a_lm, newtons, at index l (l + 1) + m; with cos(m phi), and with
    sin(|m| phi) for m < 0.
    """

    def __init__(self, degree: int) -> None:
        if degree < 1:
            raise InvalidArgument("degree", f"{degree}", "1 or more")
        self.degree = degree
        self.by_direction = np.zeros(len(icosahedral_directions()))
        self.coefficients = np.zeros((degree + 1) ** 2)

    def add(self, vectors_n: ArrayLike) -> None:
        """Add force vectors, newtons, float [n, 3]; vectors of length 0 do not count."""
        from touchfield.measure.kernels import sums_by_direction

        forces, directions = np.ascontiguousarray(vectors_n, np.float64), icosahedral_directions()
        by_direction, coefficients = sums_by_direction(
            forces, directions, 1 / SPREAD**2, harmonic_norms(self.degree)
        )
        self.by_direction += by_direction
        self.coefficients += coefficients

    def power(self) -> Float64s:
        """P_1 .. P_degree, float64 [degree], 0 to 1; all 0 if there was no force."""
        total = self.by_direction.sum()
        squares = self.coefficients**2
        edges = np.arange(self.degree + 1) ** 2
        of_degree = np.add.reduceat(squares, edges)[1:]
        factors = 4 * math.pi / (2 * np.arange(1, self.degree + 1) + 1)
        power: Float64s = np.clip(factors * of_degree / (total**2 or 1.0), 0.0, 1.0)
        return power


@cache
def icosahedral_directions() -> Float64s:
    """Return 42 unit vectors, float64 [42, 3]: icosahedron corners and edge midpoints.

    They are in ascending order and equal the coder's codebook "ico2", which lies in a higher layer.
    """
    golden = (1 + math.sqrt(5)) / 2
    rectangle = np.array([(0.0, a, b * golden) for a in (1, -1) for b in (1, -1)])
    corners = np.concatenate([np.roll(rectangle, shift, axis=1) for shift in range(3)])
    first, second = np.nonzero(np.triu(np.isclose(corners @ corners.T, golden)))  # neighbours
    points = np.concatenate([corners, corners[first] + corners[second]])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    ordered: Float64s = points[np.lexsort(np.round(points, 9).T[::-1])]
    ordered.flags.writeable = False
    return ordered


LEVELS: Final = 5
"""Number of octree levels; the finest has 32 cells along each axis."""


def octree_levels(
    grid: Grid, positions: Int32s, amplitudes_n: Float32s, thresholds_n: Float64s
) -> tuple[Float64s, Float64s]:
    """Support fractions and entropies of one frame at each octree level.

    `positions` int32 [L, 3]: indices of the samples that count, at least one. `amplitudes_n` float32 [L]:
    newtons. `thresholds_n` float64 [K]: ascending borders of the classes of amplitude, newtons; amplitudes
    below the first border are a class, too. Returns fractions, float64 [LEVELS], and bits per cell, float64
    [LEVELS].
    """
    spacing = np.asarray(grid.spacing_m)
    low, high = positions.min(axis=0), positions.max(axis=0)
    side = float(((high - low + 1) * spacing).max())
    centre = (low + high) / 2 * spacing
    scaled = (positions * spacing - centre) / side + 0.5
    coarsest = float(np.max(np.where(high > low, spacing, 0.0)))
    fractions, entropies = np.zeros(LEVELS), np.zeros(LEVELS)
    for level in range(1, LEVELS + 1):
        cells = 1 << level
        if level > 1 and side / cells < coarsest * (1 - 1e-9):
            fractions[level - 1], entropies[level - 1] = fractions[level - 2], entropies[level - 2]
            continue
        # a small offset, so that rounding does not decide which cell a sample on a border lies in
        x, y, z = np.clip(np.floor(scaled * cells + 1e-9).astype(np.int64), 0, cells - 1).T
        of_sample = (x * cells + y) * cells + z
        occupied, cell = np.unique(of_sample, return_inverse=True)
        means = np.bincount(cell.reshape(-1), amplitudes_n) / np.bincount(cell.reshape(-1))
        counts = np.bincount(np.searchsorted(thresholds_n, means, side="right"))
        fractions[level - 1] = len(occupied) / cells**3
        entropies[level - 1] = entropy_bits(np.append(counts, cells**3 - len(occupied)))
    return fractions, entropies


DESCRIPTOR_VERSION: Final = 2
"""Incremented whenever a number of the vector changes its meaning."""

DEGREE: Final = 8
WEBER_FRACTION: Final = 0.1
FORCES_N: Final = (0.05, 3.3)
"""Range of the amplitude levels, newtons: F_0 of the mask in version 1, and the peak force of a desktop
device (the last Weber step lies below it). Constant, because another F_0 would give another descriptor."""

LAG_S: Final = 1 / 30
"""Time between the two frames that are compared for change, seconds; one frame at lower frame rates, and the
length of the medium if that is shorter."""

PARTS: Final = MappingProxyType(
    {
        "amplitude": 21,
        "directions": 42,
        "direction_power": DEGREE,
        "shells": SHELLS * (SHELL_DEGREE + 1),
        "support": LEVELS,
        "level_entropy": LEVELS,
        "change": 1,
        "turnover": 1,
    }
)
"""Names of the parts, in order, and the number of values of each."""

DESCRIPTOR_LENGTH: Final = sum(PARTS.values())

_BRICKS = 1 << 11  # at a time


@dataclass(frozen=True, eq=False)
class Descriptor(EqualByValue):
    """A descriptor of a medium; see the module.

    `values` float64 [125]: all parts one after the other, each number from 0 to 1; InvalidArgument otherwise.
    """

    values: Float64s

    def __post_init__(self) -> None:
        values = numbers_of("descriptor", self.values).copy()
        if values.shape != (DESCRIPTOR_LENGTH,):
            raise InvalidArgument("descriptor", f"shape {values.shape}", f"({DESCRIPTOR_LENGTH},)")
        if not ((values >= 0) & (values <= 1)).all():
            raise InvalidArgument("descriptor", "a number below 0, above 1 or NaN", "numbers from 0 to 1")
        values.flags.writeable = False
        object.__setattr__(self, "values", values)

    def __getitem__(self, part: str) -> Float64s:
        """One part by name."""
        require_one_of("part", part, PARTS)
        return self.values[dict(part_slots())[part]]


def part_slots() -> Iterator[tuple[str, slice]]:
    """Yield each part's name and its slice of the vector."""
    start = 0
    for name, size in PARTS.items():
        yield name, slice(start, start + size)
        start += size


def descriptor(medium: HapticMedium | ForceField, frames: int = 8) -> Descriptor:
    """Describe a medium for an index; a field is a medium of one frame.

    `frames`: the largest number of frames to sample; each is compared with the one 1/30 s later, if there is
    one. InvalidArgument if none of these frames has a force of 0.05 N, or `frames` is below 1.
    """
    if frames < 1:
        raise InvalidArgument("frames", f"{frames}", "1 or more")
    source = HapticMedium.from_frames([medium], 30.0) if isinstance(medium, ForceField) else medium
    lag = min(max(1, round(source.rate_hz * LAG_S)), max(1, len(source) - 1))
    starts = max(1, len(source) - lag)
    sampled = evenly_spaced(starts, frames)
    directions, classes = DirectionSums(DEGREE), np.zeros(PARTS["amplitude"])
    levels, changes, shells = [], [], []
    for n in sampled:
        field = source[n]
        support = field.support()
        is_counted = support.amplitudes_n >= FORCES_N[0]
        if is_counted.any():
            amplitudes = support.amplitudes_n[is_counted]
            directions.add(field.vectors_n()[is_counted])
            classes += _level_weights(amplitudes)
            positions = support.positions[is_counted]
            shells.append(shell_power(positions * np.asarray(field.grid.spacing_m), amplitudes))
            levels.append(octree_levels(field.grid, positions, amplitudes, thresholds_n()))
        if n + lag < len(source):
            changes.append(_change(field, source[n + lag]))
    if not levels:
        raise InvalidArgument(
            "medium",
            f"no force of {FORCES_N[0]} N in {len(sampled)} frames",
            "something to feel",
            "Take other frames, or look at the source.",
        )
    fractions, entropies = np.mean(levels, axis=0)
    change, turnover = np.mean(changes, axis=0) if changes else (0.0, 0.0)
    parts = {
        "amplitude": np.sqrt(classes / classes.sum()),
        "directions": np.sqrt(directions.by_direction / directions.by_direction.sum()),
        "direction_power": np.sqrt(directions.power()),
        "shells": np.mean(shells, axis=0).ravel(),
        "support": fractions,
        "level_entropy": entropies / math.log2(len(classes) + 1),
        "change": [change],
        "turnover": [turnover],
    }
    values: Float64s = np.concatenate([parts[name] for name in PARTS])
    return Descriptor(np.clip(values, 0.0, 1.0))


@cache
def thresholds_n() -> Float64s:
    """Return the levels of the amplitude, newtons, float64 [21].

    They separate the classes of the octree cells.
    """
    return WeberLadder.spanning(WEBER_FRACTION, *FORCES_N).thresholds_n


def _level_weights(amplitudes_n: Float32s) -> Float64s:
    """Return the voxels per level of `thresholds_n`.

    Each voxel is shared between the two nearest levels.
    """
    levels = np.log(thresholds_n())
    rank = np.interp(np.log(amplitudes_n.astype(np.float64)), levels, np.arange(len(levels)))
    lower = np.minimum(rank.astype(np.int64), len(levels) - 2)
    upper_weight = rank - lower
    shared = np.zeros(len(levels))
    for level, weight in ((lower, 1 - upper_weight), (lower + 1, upper_weight)):
        shared += np.bincount(level, weight, len(levels))
    return shared


def _change(before: ForceField, after: ForceField) -> tuple[float, float]:
    """Return the change and the turnover between two frames.

    Change: sqrt(sum |b - a|^2 / (sum (|a|^2 + |b|^2) / 2)) / 2. Turnover: |A xor B| / |A or B|, where A and B
    are the counted voxels of the two frames. Both are 0 without any force.
    """
    grid = before.grid
    keys = np.union1d(brick_keys(grid, before.bricks), brick_keys(grid, after.bricks))
    moved = power = 0.0
    alone = either = 0
    for start in range(0, len(keys), _BRICKS):
        a, b = (f.forces_at(keys[start : start + _BRICKS]).astype(np.float64) for f in (before, after))
        squares = [np.einsum("...i,...i->...", f, f) for f in (b - a, a, b)]
        moved += float(squares[0].sum())
        power += float(squares[1].sum() + squares[2].sum()) / 2
        in_a, in_b = (np.sqrt(square) >= FORCES_N[0] for square in squares[1:])
        alone, either = alone + int((in_a ^ in_b).sum()), either + int((in_a | in_b).sum())
    return (math.sqrt(moved / power) / 2 if power else 0.0), (alone / either if either else 0.0)
