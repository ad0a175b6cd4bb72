"""Finds the samples of a medium that a hand can reach. The others need not be sent (paper section 6.1,
"culling").

Other samples need not be sent. The hand is a mass m that pushes with at most P in any direction and is never
faster than v. Let A be a set of points, d(x) the distance from x to A, and e the direction from the nearest
point of A to x. Since d is the minimum of the distances to the points of A, any path satisfies, in the sense
of an upper bound, d'' <= (v^2 - d'^2) / d + e . (P + F) / m. Where

    -e . F - mu |F across e|  >=  P + m v^2 / d + m v^2 / (2 D)                                          (*)

holds throughout the layer from d0 to d0 + D, d'' is below -v^2 / (2 D): a hand that passes d0 with d' <= v
turns back before d0 + D. Whatever it does, including a run-up or pushing off another wall, it never gets
farther from A.

A therefore begins as the force-free space in which a hand can start, without points that are nearer than r to
a force; cells of the layer where (*) fails join A, until none does. Points that join count as r farther away
than they are, so that the layer lies as deep below them as below a surface; in (*) d stays the actual
distance. Damping only helps. Work against the field would prove nothing, because a hand that swings in the
field gains energy with each turn. Its speed is bounded instead, and what must be stopped is its inward
motion.

(*) is tested for whole cells, multiplied by |x - a|, for each a that is nearest to some point x of the cell.
F is trilinear. The mean of -(c - a) . F(c) over the corners c, weighted as F is, exceeds -(x - a) . F by at
most h / 4 times the decrease of F from one sample to the next along each axis; and the mean of |c - a| is not
below |x - a|.

A moving medium has one A, the space that is free in any of its frames, and (*) must hold in all frames: space
that a body passes through is open.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, binary_erosion, binary_propagation, distance_transform_edt

from touchfield.arrays import Bools, Float32s, Float64s, lengths_of
from touchfield.compute.threads import for_chunks
from touchfield.errors import require_positive
from touchfield.medium.budget import require_memory

if TYPE_CHECKING:
    from touchfield.medium import HapticMedium


_MARGIN: Final = 1.05  # factor on the force that (*) requires, because the force comes a tick late
_USED: Final = (0.4, 0.6)  # fractions of the field's largest force to try as the required force
_RETREAT: Final = 4.0  # r, in diagonals of a cell; seen from this distance A is smooth
_TO_TURN: Final = 0.4  # maximum of m v^2 / d, as a fraction of the required force minus the push
# maximum fraction of weak samples where the layer may begin; fraction of weak cells from which a layer is
# given up
_FEW, _HOPELESS = 0.03, 0.7
_LEAKS: Final = 0.02  # nodes that joined, as a fraction of A; fewer are roughness and no leak
_FRAMES_BYTES: Final = 1 << 28
_ALL = np.ones((3, 3, 3), bool)


@dataclass(frozen=True)
class Hand:
    """A hand with its device: largest push, mass, and largest speed; each above 0."""

    push_n: float
    mass_kg: float
    speed_m_s: float

    def __post_init__(self) -> None:
        require_positive(push_n=self.push_n, mass_kg=self.mass_kg, speed_m_s=self.speed_m_s)

    @property
    def lunge_nm(self) -> float:
        """m v^2, twice the largest kinetic energy, N m."""
        return self.mass_kg * self.speed_m_s**2

    @property
    def text(self) -> str:
        """A description of the hand for which the result holds."""
        grams, push, speed = 1e3 * self.mass_kg, self.push_n, self.speed_m_s
        return (
            f"a hand of {grams:g} g with its device that pushes with {push:g} N and moves at {speed:g} m/s "
            "at most"
        )


class _Layer(NamedTuple):
    """The layer in which the field must hold the hand back.

    `retreat_m`, `start_m`, `depth_m`: the distances r, d0 and d0 + D, metres. `need_n`: the required force,
    newtons, approximate.
    """

    retreat_m: float
    start_m: float
    depth_m: float
    need_n: float


class Reach(NamedTuple):
    """Samples that a hand can feel, and the force that stops it.

    `samples`: bool [nx, ny, nz]; the corners of cells that the hand can enter, and one more sample on every
    side. `stopped_n`: newtons; 0 if no layer was found to stop it.
    """

    samples: Bools
    stopped_n: float


def reach_of(medium: HapticMedium, hand: Hand) -> Reach:
    """Return the samples that a hand can feel.

    The hand starts in free space and stays between the outermost samples.
    """
    grid, count = medium.grid, len(medium)
    require_memory("frame as a dense array", f"{grid.voxel_count} samples", 100 * grid.voxel_count)
    spread = np.unique(np.linspace(0, count - 1, 16).astype(int))
    greatest_n = max(float(lengths_of(medium[int(i)].forces_n).max(initial=0.0)) for i in spread)
    best, stopped_n = np.ones(grid.shape, bool), 0.0
    for layer in _layers(medium, hand, greatest_n):
        flood = _Flood(medium, layer, hand)
        samples = flood.settled()
        if np.count_nonzero(samples) < np.count_nonzero(best):
            best, stopped_n = samples, layer.need_n
        # nothing leaks; a thicker layer only reaches deeper
        if flood.joined.sum() <= _LEAKS * flood.began.sum():
            break
    return Reach(best, stopped_n)


def _layers(medium: HapticMedium, hand: Hand, greatest_n: float) -> list[_Layer]:
    """Layers to try, the thinnest first.

    `greatest_n` is the largest force of the field.
    """
    if min(medium.grid.shape) < 2:
        return []
    found: list[_Layer] = []
    diagonal_m = math.hypot(*medium.grid.spacing_m)
    size = lengths_of(medium[0].to_dense())
    is_supported, bin_m = size > 0, 0.25 * diagonal_m
    bins = (distance_transform_edt(is_supported, medium.grid.spacing_m)[is_supported] / bin_m).astype(int)
    bin_counts = np.bincount(bins)
    for need in (used * greatest_n for used in _USED):
        spare = need / _MARGIN - hand.push_n
        if spare <= 0:
            continue
        # depth in the field from which its force is sufficient, except at a few samples
        strong = np.flatnonzero(
            (bin_counts > 0) & (np.bincount(bins, size[is_supported] < need) <= _FEW * bin_counts)
        )
        deep_m = float(strong[0] if len(strong) else len(bin_counts)) * bin_m
        ramp_m = max(deep_m + diagonal_m, hand.lunge_nm / (_TO_TURN * spare))
        stop_m = hand.lunge_nm / (2 * (spare - hand.lunge_nm / ramp_m))
        start_m = _RETREAT * diagonal_m + ramp_m
        found.append(_Layer(_RETREAT * diagonal_m, start_m, start_m + stop_m, need))
    return sorted(found, key=lambda layer: layer.depth_m)


class _Flood:
    """The set A, as nodes of the lattice of a medium, and its growth."""

    def __init__(self, medium: HapticMedium, layer: _Layer, hand: Hand) -> None:
        self.medium, self.layer = medium, layer
        self.turn_nm = _MARGIN * hand.lunge_nm
        self.need_n = _MARGIN * (hand.push_n + 0.5 * hand.lunge_nm / (layer.depth_m - layer.start_m))
        self.step_m = np.array(medium.grid.spacing_m)
        self.diagonal_m = float(np.linalg.norm(self.step_m))
        self.beyond = int(
            layer.retreat_m / float(self.step_m.min())
        )  # A may extend beyond the box, although the hand does not
        self.free = self._free()
        is_clear = self.free & (self._distance(~self.free) >= layer.retreat_m)
        self.began = is_clear if is_clear.any() else self.free
        self.joined = np.zeros_like(self.began)
        self.distance_m = self._distance_to_a()

    def settled(self) -> Bools:
        """Grow A until (*) holds; return the samples that are felt.

        These are all samples if most of the layer is weak.
        """
        weak, weak_fraction = self._weak(None)
        if weak_fraction > _HOPELESS or not self.free.any():
            return np.ones(self.medium.grid.shape, bool)
        while True:
            weak = weak if weak.any() else self.free & (self.distance_m > self.layer.start_m)
            if not weak.any():
                reached = self._inner(self._bounds()[0]) <= self.layer.depth_m
                # corners of these cells, and a sample more on every side
                return np.asarray(
                    binary_dilation(np.pad(reached, (0, 1)), np.ones((4, 4, 4), bool), origin=-1)
                )
            changed = self._distance(weak) + self.layer.retreat_m
            self.joined |= weak
            self.distance_m = self._distance_to_a()
            weak, _ = self._weak(changed)

    def _parts(self) -> Iterator[Float32s]:
        """Yield frames, float32 [f, nx, ny, nz, 3], as many at a time as memory allows."""
        count = len(self.medium)
        max_frames = max(1, _FRAMES_BYTES // (12 * self.medium.grid.voxel_count))
        for a in range(0, count, max_frames):
            yield np.stack([self.medium[i].to_dense() for i in range(a, min(a + max_frames, count))])

    def _free(self) -> Bools:
        """Return the nodes that are free of force in any frame.

        If some of them lie on the faces of the box, only those connected to these are returned.
        """
        nodes = np.logical_or.reduce([(~part.any(axis=4)).any(axis=0) for part in self._parts()])
        at_faces = nodes.copy()
        at_faces[1:-1, 1:-1, 1:-1] = False
        free = binary_propagation(at_faces, _ALL, mask=nodes) if at_faces.any() else nodes
        return np.pad(free, self.beyond, mode="edge")

    def _distance(self, nodes: Bools) -> Float64s:
        if not nodes.any():
            return np.full(nodes.shape, math.inf)
        return np.asarray(distance_transform_edt(~nodes, self.step_m))

    def _distance_to_a(self) -> Float64s:
        """d at the nodes, metres.

        Nodes that joined A lie where a force begins; r is added to the distance to them.
        """
        return np.minimum(self._distance(self.began), self._distance(self.joined) + self.layer.retreat_m)

    def _bounds(self) -> tuple[Float64s, Float64s]:
        """Lower and upper bound of d within each cell."""
        corners = [self.distance_m[i:, j:, k:][tuple(slice(n - 1) for n in self.distance_m.shape)]
                   for i, j, k in np.ndindex(2, 2, 2)]  # fmt: skip
        lowest, highest = np.minimum.reduce(corners), np.maximum.reduce(corners)
        half, diagonal = 0.5 * self.diagonal_m, self.diagonal_m
        return np.maximum(lowest - half, highest - diagonal), np.minimum(highest + half, lowest + diagonal)

    def _inner(self, cells: NDArray[Any]) -> NDArray[Any]:
        """The cells within the box of the medium."""
        return cells[tuple(slice(self.beyond, n - self.beyond) for n in cells.shape)]

    def _weak(self, changed: Float64s | None) -> tuple[Bools, float]:
        """Corner nodes of weak cells of the layer, without those that joined A already.

        A cell is weak if the field does not hold there. Also returns the fraction of weak cells. `changed` is
        the distance to the nodes that joined last, plus r; only cells that these may affect are tested, or
        all cells of the layer if it is None.
        """
        from touchfield.reduction import kernels

        layer = self.layer
        low, high = self._bounds()
        is_tested = np.zeros(high.shape, bool)
        self._inner(is_tested)[...] = self._inner((high >= layer.start_m) & (low <= layer.depth_m))
        if changed is not None:
            is_tested &= changed[tuple(slice(n - 1) for n in changed.shape)] <= high + 2 * self.diagonal_m
        cells = np.argwhere(is_tested)
        edges = np.stack(
            [
                nodes_of & ~binary_erosion(nodes_of, _ALL, border_value=1)
                for nodes_of in (self.began, self.joined)
            ]
        )
        weak = np.zeros(len(cells), bool)
        for part in self._parts() if len(cells) else ():
            open_cells = np.flatnonzero(~weak)
            found = np.zeros(len(open_cells), bool)
            arguments = (
                cells[open_cells],
                high[tuple(cells[open_cells].T)],
                edges,
                layer.retreat_m,
                self.beyond,
            )
            hold = self.step_m, self.need_n, self.turn_nm, self.medium.friction
            for_chunks(kernels.weak_cells, len(open_cells), *arguments, part, *hold, found, chunk=256)
            weak[open_cells] = found
        nodes = np.zeros(self.began.shape, bool)
        for corner in np.ndindex(2, 2, 2):
            nodes[tuple((cells[weak] + corner).T)] = True
        return nodes & ~self.joined, float(weak.mean()) if len(weak) else 0.0
