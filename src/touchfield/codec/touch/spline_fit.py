"""The encoder's side of the spline guess: the coefficients whose field is within the mask at most samples (floats).

A first fit is linear: f should be |F| where that is below the top, and its gradient -K n. Then some steps of
Gauss and Newton on the force itself, whose weights fall where the mask is left (an L1 norm beyond it), so that an
edge that no spline can follow does not bend what lies around it. Eight samples of each cell of the lattice of nodes
are looked at. The coarsest lattice that will do is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.brick_list import CONTEXTS as LIST_CONTEXTS
from touchfield.codec.brick_list import code_bricks, padded
from touchfield.codec.kernels.bits import end_of, fresh, writer
from touchfield.codec.touch import spline
from touchfield.codec.touch.fixed_field import TOP
from touchfield.codec.touch.kernels.spline import PAD, REACH, code_nodes, weights
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.kernels.choice import Limits
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.medium import ForceField

    Floats = NDArray[np.float32]

__all__ = ["fit"]

_LOOKED_AT: Final = 64  # bricks that tell whether a field is smooth, and its stiffness
_LEAST_SMOOTH: Final = 0.78  # of the samples there, along two axes at least
_HOPELESS: Final = 0.05  # below it a finer lattice is not tried either
_MOST_CELLS: Final = 1 << 13  # of a finer lattice
_MOST_SPREAD: Final = 4  # bytes of an empty box for each brick
_MISS_BITS: Final = 3.0  # that a sample takes which the guess misses, about
_STEP: Final = 2.0  # of a coefficient, in tolerances of a small force
_SATURATED: Final = 0.97
_EMPTY: Final = 0.3  # weight of samples without a force
_ALONG: Final = 0.1  # weight of the gradient's length beside its direction's
_ROUGHNESS: Final = 3e-4
_FIRST_TURNS, _TURNS, _ROUNDS = 16, 12, 3


@dataclass(frozen=True)
class _Frame:
    """A frame in units, and what is asked of its guess."""

    field: ForceField
    forces: Floats  # [n, 8, 8, 8, 3]
    lengths: Floats
    k: float
    f0: float
    top: float
    stiffness: float  # units a metre

    def tolerance(self, lengths: Floats) -> Floats:
        out: Floats = np.maximum(np.float32(self.f0), np.float32(self.k) * lengths)
        return out

    def kept(self, guess: FixedField) -> tuple[int, int]:
        """Samples with a force at which the guess is within the mask, and those at which it is not."""
        error = guess.vectors - self.forces
        within = np.einsum("...i,...i", error, error) <= self.tolerance(self.lengths) ** 2
        held = self.lengths > 0
        good = int(np.count_nonzero(within & held))
        return good, int(np.count_nonzero(held)) - good


def fit(frame: ForceField, lattice: Lattice, limits: Limits) -> tuple[bytes, FixedField] | None:
    """The bytes of a spline guess for a frame, and the guess that `synthesise` makes of them, good or bad.

    Parameters
    ----------
    frame : ForceField
    lattice : Lattice
        Gives the unit.
    limits : Limits
        The mask that the guess should keep where it can.

    Returns
    -------
    (bytes, FixedField) or None
        None where the field is not smooth enough.
    """
    seen = _looked_at(frame, lattice, limits)
    if seen is None:
        return None
    best: tuple[float, bytes, FixedField] | None = None
    shifts = (3, 3, 3)
    while True:
        data, guess = _coded(seen, shifts, _coefficients(seen, shifts))
        good, bad = seen.kept(guess)
        told, missed = 8.0 * len(data), _MISS_BITS * bad
        if best is not None and told + missed >= best[0]:
            break
        best = told + missed, data, guess
        finer = _finer(shifts, frame.grid.spacing_m)
        # a finer lattice takes some times the bytes
        if missed < told or good < _HOPELESS * (good + bad) or finer is None:
            break
        if len(frame.bricks) << 9 - sum(finer) > _MOST_CELLS:
            break
        shifts = finer
    return best[1:]


def _finer(shifts: tuple[int, int, int], spacing_m: tuple[float, float, float]) -> tuple[int, int, int] | None:
    """Half the distance along the axes where nodes lie farthest apart."""
    apart = np.ldexp(spacing_m, shifts)
    a, b, c = (np.array(shifts) - (apart > 0.7 * apart.max())).tolist()
    return None if min(a, b, c) < 1 else (a, b, c)


def _looked_at(frame: ForceField, lattice: Lattice, limits: Limits) -> _Frame | None:
    """The frame in units, if some of its bricks are smooth, with the stiffness that they speak for."""
    count = len(frame.bricks)
    k, f0 = (0.0, float(lattice.floor)) if limits.free else (limits.k, max(limits.f0, 1.0))
    if not count or f0 >= TOP or spline.least_size(frame.bricks) > _MOST_SPREAD * count:
        return None
    some = frame.forces_n[:: -(-count // _LOOKED_AT)] / np.float32(lattice.unit_n)
    lengths = np.sqrt(np.einsum("...i,...i", some, some))
    inner, slopes, tests = slice(1, -1), [], []
    middle, size = some[:, inner, inner, inner], lengths[:, inner, inner, inner]
    tolerance = np.maximum(f0, k * size)
    for axis in range(3):
        sides = [np.roll(some, d, 1 + axis)[:, inner, inner, inner] for d in (1, -1)]
        ends = [np.roll(lengths, d, 1 + axis)[:, inner, inner, inner] for d in (1, -1)]
        bent = (sides[0] + sides[1]) / 2 - middle
        held = (size > 0) & (ends[0] > 0) & (ends[1] > 0)
        tests.append(
            np.count_nonzero((np.einsum("...i,...i", bent, bent) <= tolerance**2) & held) / max(held.sum(), 1)
        )
        slopes.append((ends[0] - ends[1]) / (2 * frame.grid.spacing_m[axis]) * middle[..., axis])
    if np.median(tests) < _LEAST_SMOOTH:
        return None
    ramp = (size > 0.15 * TOP) & (size < 0.8 * TOP)
    growth = sum(slopes)[ramp] / size[ramp]
    stiffness = float(np.quantile(growth, 0.75)) if len(growth) else 0.0
    if stiffness * min(frame.grid.spacing_m) < 1:
        return None
    forces = frame.forces_n / np.float32(lattice.unit_n)
    lengths = np.sqrt(np.einsum("...i,...i", forces, forces))
    # a force law has a top where many samples share it
    saturates = np.count_nonzero(lengths > _SATURATED * TOP) > 0.02 * np.count_nonzero(lengths)
    return _Frame(frame, forces, lengths, k, f0, TOP if saturates else 2.0 * TOP - 1, stiffness)


def _coded(seen: _Frame, shifts: tuple[int, int, int], values: NDArray[np.float64]) -> tuple[bytes, FixedField]:
    grid, bricks = seen.field.grid, seen.field.bricks
    growths = [seen.stiffness * s for s in grid.spacing_m]
    a, b, c = (int(np.clip(np.rint(2**35 / (1152 * g)), 1, (1 << 20) - 1)) for g in growths)
    step = int(np.clip(_STEP * max(seen.f0, 0.15 * seen.k * TOP), 1, (1 << 20) - 1))
    head = spline.Head(shifts, step, int(seen.top), (a, b, c))
    nodes, low = spline.nodes_of(bricks, shifts)
    inside = nodes.values[PAD:, PAD:, PAD:]
    inside[...] = np.rint(np.clip(values, -REACH, REACH))
    nodes.values[nodes.wanted == 0] = 0
    told = writer(320 * len(bricks) + 64 * int(nodes.wanted.sum()) + 64, fresh(spline.CONTEXTS, spline.SETS))
    code_bricks(told, 0, 0, grid.brick_shape, bricks, None)
    code_nodes(told, LIST_CONTEXTS, nodes, step)
    code = padded(end_of(told), len(bricks)).ljust(spline.least_size(bricks), b"\0")
    return head.to_bytes() + code, spline.forces_of(head, grid, bricks, nodes.values, low)


# -- the fit --------------------------------------------------------------------------------------------------


class _Cells:
    """The samples that are looked at, eight of each cell, and the nodes around them.

    Attributes
    ----------
    forces, lengths : float32 [cells, 8, 3], [cells, 8]
    shape : (int, int, int)
        Nodes of the box.
    """

    def __init__(self, seen: _Frame, shifts: tuple[int, int, int]) -> None:
        bricks, grid = seen.field.bricks, seen.field.grid
        room, low = spline.nodes_of(bricks, shifts)
        self.shape = tuple(n - PAD for n in room.wanted.shape)
        samples, nodes, basis = [], [], []
        for axis, shift in enumerate(shifts):
            cells, h = BRICK >> shift, 1 << shift
            phases = np.array([h // 4, 3 * h // 4])
            samples.append(np.arange(cells)[:, None] * h + phases)
            first = (bricks[:, axis].astype(np.int64) * BRICK >> shift) - 1 - low[axis]
            nodes.append(first[:, None] + np.arange(cells))
            table = weights(shift)[:, phases].astype(np.float64)
            basis.append((table[0] / (6 * h**3), table[1] / (2 * h**3 * grid.spacing_m[axis])))
        x, y, z = (s.ravel() for s in samples)
        picked = seen.forces[:, x[:, None, None], y[:, None], z]
        counts = [BRICK >> s for s in shifts]
        split = picked.reshape(len(bricks), counts[0], 2, counts[1], 2, counts[2], 2, 3)
        self.forces = np.ascontiguousarray(split.transpose(0, 1, 3, 5, 2, 4, 6, 7)).reshape(-1, 8, 3)
        self.lengths = np.sqrt(np.einsum("...i,...i", self.forces, self.forces))
        self.basis = np.concatenate(
            [
                np.einsum("ia,jb,kc->ijkabc", *(basis[axis][axis == q] for axis in range(3))).reshape(8, 64)
                for q in (-1, 0, 1, 2)
            ]
        ).astype(np.float32)  # [4 * 8, 64]: value, and the derivatives by x, y, z
        _, ny, nz = self.shape
        corners = (nodes[0][:, :, None, None] * ny + nodes[1][:, None, :, None]) * nz + nodes[2][:, None, None, :]
        i = np.arange(4)
        around = ((i[:, None, None] * ny + i[:, None]) * nz + i).ravel()
        self.at = corners.reshape(-1, 1) + around

    def potential(self, c: Any) -> Floats:
        """f and its gradient, float32 [cells, 4, 8], of coefficients."""
        out: Floats = (c.astype(np.float32)[self.at] @ self.basis.T).reshape(-1, 4, 8)
        return out

    def gathered(self, pull: Floats) -> Any:
        """What `pull`, float32 [cells, 4, 8], comes to at the nodes: the transposed of `potential`."""
        share = pull.reshape(-1, 32) @ self.basis
        return np.bincount(self.at.ravel(), weights=share.ravel(), minlength=int(np.prod(self.shape)))


@dataclass(frozen=True)
class _Tangent:
    """The force at some coefficients, and how it changes with f and its gradient; arrays over [cells, 8].

    Attributes
    ----------
    missing : float32 [cells, 3, 8]
        What the force lacks.
    direction : float32 [cells, 3, 8]
        Of the force; shorter than one where the gradient is less than half the stiffness.
    moves, turns : float32
        1 where the force grows with f, and where only the direction of the gradient matters.
    lean : float32
        The force over the gradient.
    """

    missing: Floats
    direction: Floats
    moves: Floats
    turns: Floats
    lean: Floats

    @classmethod
    def at(cls, seen: _Frame, cells: _Cells, c: Any) -> _Tangent:
        f = cells.potential(c)
        steep, half = np.sqrt((f[:, 1:] ** 2).sum(axis=1)), np.float32(seen.stiffness / 2)
        slow, value = np.maximum(steep, half), np.clip(f[:, 0], 0, np.float32(seen.top))
        direction = -f[:, 1:] / slow[:, None]
        missing = cells.forces.transpose(0, 2, 1) - value[:, None] * direction
        moves = ((f[:, 0] > 0) & (f[:, 0] < seen.top)).astype(np.float32)
        return cls(missing, direction, moves, (steep > half).astype(np.float32), value / slow)

    def change(self, f: Floats) -> Floats:
        """Of the force, float32 [cells, 3, 8], with f and its gradient, float32 [cells, 4, 8]."""
        along = (self.direction * f[:, 1:]).sum(axis=1) * self.turns
        across = f[:, 1:] - along[:, None] * self.direction
        out: Floats = (self.moves * f[:, 0])[:, None] * self.direction - self.lean[:, None] * across
        return out

    def pull(self, r: Floats) -> Floats:
        """The transposed of `change`."""
        out: Floats = np.empty((len(r), 4, 8), np.float32)
        along = (self.direction * r).sum(axis=1)
        out[:, 0] = self.moves * along
        out[:, 1:] = -self.lean[:, None] * (r - (self.turns * along)[:, None] * self.direction)
        return out


def _coefficients(seen: _Frame, shifts: tuple[int, int, int]) -> Any:
    """The coefficients in units, float64 of the shape of the box of nodes."""
    cells = _Cells(seen, shifts)
    tolerance, held = seen.tolerance(cells.lengths), cells.lengths > 0
    c = _first(seen, cells, tolerance)
    weight = np.where(held, tolerance**-2, np.float32(_EMPTY * seen.f0**-2))
    best, least = c, np.inf
    for turn in range(_ROUNDS + 1):
        at = _Tangent.at(seen, cells, c)
        share = np.sqrt((at.missing**2).sum(axis=1)) / tolerance
        total = float(np.minimum(share, 4)[held].sum())
        if total < least:
            best, least = c, total
        if turn == _ROUNDS:
            break
        robust = (weight / np.maximum(1, share))[:, None]
        rough = _ROUGHNESS * 8 * float(weight.mean())

        def normal(x: Any, at: _Tangent = at, robust: Floats = robust, rough: float = rough) -> Any:
            pull = at.pull(robust * at.change(cells.potential(x)))
            return cells.gathered(pull) + rough * _bending(x, cells.shape)

        wanted = cells.gathered(at.pull(robust * at.missing)) - rough * _bending(c, cells.shape)
        c = c + _solved(normal, wanted, _TURNS)
    return best.reshape(cells.shape)


def _first(seen: _Frame, cells: _Cells, tolerance: Floats) -> Any:
    """Coefficients whose f is |F| below the top, and whose gradient is -K n."""
    size, stiffness = cells.lengths, np.float32(seen.stiffness)
    normal = (cells.forces / np.maximum(size, 1)[..., None]).transpose(0, 2, 1)
    value = np.where((size > 0) & (size < _SATURATED * seen.top), tolerance**-2, 0)
    turn = np.where(size > 0, (size / (stiffness * tolerance)) ** 2, 0)[:, None]
    rough = _ROUGHNESS * 8 * float(value.mean())

    def weighed(f: Floats) -> Floats:
        along = np.float32(1 - _ALONG) * (f[:, 1:] * normal).sum(axis=1)
        return np.concatenate([(value * f[:, 0])[:, None], turn * (f[:, 1:] - along[:, None] * normal)], axis=1)

    def pulled(x: Any) -> Any:
        return cells.gathered(weighed(cells.potential(x))) + rough * _bending(x, cells.shape)

    wanted = np.concatenate([size[:, None], -stiffness * normal], axis=1)
    return _solved(pulled, cells.gathered(weighed(wanted)), _FIRST_TURNS)


def _solved(matrix: Callable[[Any], Any], right: Any, turns: int) -> Any:
    """x with ``matrix(x)`` about `right`, by so many steps of conjugate gradients."""
    x, r, p = np.zeros_like(right), right, right
    energy = start = float(r @ r)
    for _ in range(turns):
        if energy <= 1e-12 * start:
            break
        q = matrix(p)
        step = energy / float(p @ q)
        x, r = x + step * p, r - step * q
        energy, before = float(r @ r), energy
        p = r + energy / before * p
    return x


def _bending(x: Any, shape: tuple[int, ...]) -> Any:
    """The gradient of half the sum of squared second differences."""
    c = x.reshape(shape)
    out = 1e-6 * c
    for axis in range(3):
        a, o = np.moveaxis(c, axis, 0), np.moveaxis(out, axis, 0)
        d = a[2:] - 2 * a[1:-1] + a[:-2]
        o[2:] += d
        o[1:-1] -= 2 * d
        o[:-2] += d
    return out.ravel()
