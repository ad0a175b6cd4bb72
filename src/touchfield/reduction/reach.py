"""Samples that a hand can reach in a medium; the others need not be sent (paper section 6.1, "culling").

The hand is a mass m that pushes with at most P in any direction, and is never faster than v. A is a set of
places, d(x) the distance to it, e the direction from the nearest of them. d is the least of the distances to
the places of A, and so along any path, in the sense of an upper bound, d'' <= (v^2 - d'^2) / d + e . (P + F)
/ m. Where

    -e . F - mu |F across e|  >=  P + m v^2 / d + m v^2 / (2 D)                                          (*)

all over the layer from d0 to d0 + D, d'' is below -v^2 / (2 D) there: a hand that passes d0 with d' <= v
turns before d0 + D. Whatever it does, also with a run-up or off another wall, it is never farther from A. So
A begins as the space without force that a hand can start from, less what is nearer than r to a force; cells
of the layer where (*) fails join A, until none does. What joins counts as r farther off than it is, so that
the layer lies as deep below it as a surface; in (*) d stays the distance. Damping only helps. The work
against the field would prove nothing: a hand that swings in it gains energy with each turn. Its speed is
bounded, and what must be stopped is its way inwards.

(*) is tested in whole cells, times |x - a|, for each a that is nearest to some point x of the cell. F is
trilinear: the mean of the samples' own -(c - a) . F(c), weighted as F is, exceeds -(x - a) . F by at most h /
4 times what F loses from a sample to the next along each axis; and the mean of |c - a| is not below |x - a|.

A medium that moves has one A, of the space that is free in any of its frames, and (*) must hold in all of
them: what a body passes through is open.
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


_MARGIN: Final = 1.05  # of the force that (*) asks for: it comes a tick late
_USED: Final = (0.4, 0.6)  # of the field's greatest force: what (*) asks for
_RETREAT: Final = 4.0  # r, in diagonals of a cell: from a little off A is smooth
_TO_TURN: Final = 0.4  # largest fraction of the force left after the push: m v^2 / d
_FEW, _HOPELESS = 0.03, 0.7  # weak samples where the layer may begin; weak cells of a layer that is none
_LEAKS: Final = 0.02  # of A: less is roughness and no leak
_FRAMES_BYTES: Final = 1 << 28
_ALL = np.ones((3, 3, 3), bool)


@dataclass(frozen=True)
class Hand:
    """A hand with its device: what it pushes with at most, its mass, the speed it never exceeds; each
    above 0.
    """

    push_n: float
    mass_kg: float
    speed_m_s: float

    def __post_init__(self) -> None:
        require_positive(push_n=self.push_n, mass_kg=self.mass_kg, speed_m_s=self.speed_m_s)

    @property
    def lunge_nm(self) -> float:
        """m v^2."""
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
    """Where the field must hold, metres of d: r, d0 and d0 + D; and by how much, newtons, about."""

    retreat_m: float
    start_m: float
    depth_m: float
    need_n: float


class Reach(NamedTuple):
    """Samples that a hand feels, bool [nx, ny, nz]: corners of cells that it comes into, and a sample more on
    every side; a force that stops it, 0 where nothing is found to.
    """

    samples: Bools
    stopped_n: float


def reach_of(medium: HapticMedium, hand: Hand) -> Reach:
    """Return where a hand can get that starts in free space and stays between the outermost samples."""
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
        if flood.joined.sum() <= _LEAKS * flood.began.sum():  # a thicker layer only reaches deeper
            break
    return Reach(best, stopped_n)


def _layers(medium: HapticMedium, hand: Hand, greatest_n: float) -> list[_Layer]:
    """Layers to try on a field of this greatest force, the thinnest first."""
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
        # how deep in the field its force is so great, but for a few samples
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
    """A, as samples of a medium."""

    def __init__(self, medium: HapticMedium, layer: _Layer, hand: Hand) -> None:
        self.medium, self.layer = medium, layer
        self.turn_nm = _MARGIN * hand.lunge_nm
        self.need_n = _MARGIN * (hand.push_n + 0.5 * hand.lunge_nm / (layer.depth_m - layer.start_m))
        self.step_m = np.array(medium.grid.spacing_m)
        self.diagonal_m = float(np.linalg.norm(self.step_m))
        self.beyond = int(
            layer.retreat_m / float(self.step_m.min())
        )  # A may lie outside of the box, if no hand does
        self.free = self._free()
        is_clear = self.free & (self._distance(~self.free) >= layer.retreat_m)
        self.began = is_clear if is_clear.any() else self.free
        self.joined = np.zeros_like(self.began)
        self.distance_m = self._distance_to_a()

    def settled(self) -> Bools:
        """Grow A until (*) holds; return the samples that are felt, all if most of the layer is weak."""
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
        """The frames, float32 [f, nx, ny, nz, 3], as many at a time as memory allows."""
        count = len(self.medium)
        max_frames = max(1, _FRAMES_BYTES // (12 * self.medium.grid.voxel_count))
        for a in range(0, count, max_frames):
            yield np.stack([self.medium[i].to_dense() for i in range(a, min(a + max_frames, count))])

    def _free(self) -> Bools:
        """Return force-free nodes of any frame, connected to the box's faces if any such node is there."""
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
        """d at the nodes, metres: what joined A lies where a force begins, and so as far from it as that
        does.
        """
        return np.minimum(self._distance(self.began), self._distance(self.joined) + self.layer.retreat_m)

    def _bounds(self) -> tuple[Float64s, Float64s]:
        """Of each cell the least and the greatest d that a point of it may have."""
        corners = [self.distance_m[i:, j:, k:][tuple(slice(n - 1) for n in self.distance_m.shape)]
                   for i, j, k in np.ndindex(2, 2, 2)]  # fmt: skip
        lowest, highest = np.minimum.reduce(corners), np.maximum.reduce(corners)
        half, diagonal = 0.5 * self.diagonal_m, self.diagonal_m
        return np.maximum(lowest - half, highest - diagonal), np.minimum(highest + half, lowest + diagonal)

    def _inner(self, cells: NDArray[Any]) -> NDArray[Any]:
        """Those of the box."""
        return cells[tuple(slice(self.beyond, n - self.beyond) for n in cells.shape)]

    def _weak(self, changed: Float64s | None) -> tuple[Bools, float]:
        """Nodes of cells of the layer where the field does not hold, of those that `changed` is near; their
        share.
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
