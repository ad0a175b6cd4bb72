"""The error bound computed in float64 without the package: fields by numpy, bodies by docs/format/objects.md.

Each function takes dense arrays and returns the largest error relative to the allowed one, so that a value of
at most 1 is within the bound. An error where none is allowed counts as infinite.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

__all__ = [
    "Body",
    "composed_ratio",
    "direction_ratio",
    "displacement_m",
    "hidden_n",
    "mask_ratio",
    "same_bits",
    "same_support",
]

_EDGE = 1e-6  # relative: within this distance of the cut, float64 cannot decide the side of a body's force
_SUMS = 1e-11  # of the summed forces: effect of the order of additions, and of positions in a cell
_FLOAT32 = 2.0**-21  # of a force: rounding to float32 in both fields, and at the limit of the device


def _lengths(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt((vectors.astype(np.float64) ** 2).sum(axis=-1))


def _largest(error: np.ndarray, allowed: np.ndarray) -> float:
    ratio = np.full(error.shape, np.inf)
    ratio[error == 0] = 0.0
    some = (allowed > 0) & (error > 0)
    ratio[some] = error[some] / allowed[some]
    return float(ratio.max(initial=0.0))


def mask_ratio(
    source: np.ndarray, decoded: np.ndarray, k: float, f0_n: float, hidden: np.ndarray | float = 0
) -> float:
    """Largest |error| / max(F_0, k |F| + hidden) of forces [..., 3]."""
    error = _lengths(decoded.astype(np.float64) - source.astype(np.float64))
    return _largest(error, np.maximum(f0_n, k * _lengths(source) + hidden))


def direction_ratio(source: np.ndarray, decoded: np.ndarray, k: float, f0_n: float, jnd_deg: float) -> float:
    """The rule of mode "mask-direction" (`TouchSpec.mode`) of forces [..., 3]."""
    a, b = source.astype(np.float64).reshape(-1, 3), decoded.astype(np.float64).reshape(-1, 3)
    size, error = _lengths(a), _lengths(b - a)
    sine = np.sin(np.radians(jnd_deg))
    is_strong = size * sine > f0_n
    weak_ratio = _largest(error[~is_strong], np.full(np.count_nonzero(~is_strong), f0_n))
    length = _largest(np.abs(_lengths(b) - size)[is_strong], np.maximum(f0_n, k * size)[is_strong])
    # scaled first: products of the smallest forces would underflow
    scaled_a, scaled_b = (
        v[is_strong] / np.maximum(np.abs(v[is_strong]).max(axis=1, keepdims=True), 1e-300) for v in (a, b)
    )
    angle = np.arctan2(_lengths(np.cross(scaled_a, scaled_b)), (scaled_a * scaled_b).sum(axis=1))
    angle[error[is_strong] == 0] = 0.0
    return max(weak_ratio, length, float((angle / np.radians(jnd_deg)).max(initial=0.0)))


def hidden_n(source: np.ndarray, spacing_m: Sequence[float], beta: float, radius_m: float) -> np.ndarray:
    """`beta` times the weighted mean of the neighbouring |F|; float64 [x, y, z].

    Weights are exp(-2 d^2 / R^2) without the voxel itself, in a box of as many samples as fit into R along
    each axis that has more than one. Bricks of 8^3 samples without a force mask nothing.
    """
    size, shape = _lengths(source), source.shape[:3]
    reach = [int(radius_m / h * (1 + 1e-9)) if n > 1 else 0 for h, n in zip(spacing_m, shape)]
    padded = np.pad(size, [(r, r) for r in reach])
    total, weights = np.zeros(shape), 0.0
    for offset in np.ndindex(*(2 * r + 1 for r in reach)):
        away = [(o - r) * h for o, r, h in zip(offset, reach, spacing_m)]
        if any(away):
            weight = float(np.exp(-2 * sum(d * d for d in away) / radius_m**2))
            weights += weight
            total += weight * padded[tuple(slice(o, o + n) for o, n in zip(offset, shape))]
    mean = beta * total / weights if weights else total
    for low in np.ndindex(*(-(-n // 8) for n in shape)):
        brick = tuple(slice(8 * a, 8 * a + 8) for a in low)
        if not size[brick].any():
            mean[brick] = 0.0
    return mean


def same_support(source: np.ndarray, decoded: np.ndarray) -> bool:
    """True if the same samples have a force."""
    return bool(((source != 0).any(axis=-1) == (decoded != 0).any(axis=-1)).all())


def same_bits(source: np.ndarray, decoded: np.ndarray) -> bool:
    """True if every float32 is the same, with -0.0 distinct from 0.0 where a sample has any bit."""
    a, b = (np.ascontiguousarray(v, np.float32).view(np.uint32) for v in (source, decoded))
    return bool((a == b).all())


class Body(NamedTuple):
    """One body: forces [frames or 1, x, y, z, 3] on its lattice; quaternions [n, 4] and positions [n, 3]."""

    forces_n: np.ndarray
    spacing_m: np.ndarray
    origin_m: np.ndarray
    quaternions: np.ndarray
    positions_m: np.ndarray

    def at(self, frame: int) -> np.ndarray:
        """The forces of a frame."""
        return self.forces_n[min(frame, len(self.forces_n) - 1)].astype(np.float64)


def _rotation(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _interpolated(forces: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Linear interpolation between samples [x, y, z, 3] at indices [m, 3]; samples outside are zero."""
    padded = np.pad(forces, [(1, 1)] * 3 + [(0, 0)])
    last = np.array(forces.shape[:3])
    inside = ((index > -1) & (index < last)).all(axis=1)
    padded_index = index[inside] + 1
    low = np.floor(padded_index).astype(int)
    f, total = padded_index - low, np.zeros((len(padded_index), 3))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, f, 1 - f), axis=1)
        total += weight[:, None] * padded[tuple((low + corner).T)]
    out = np.zeros((len(index), 3))
    out[inside] = total
    return out


def _velocity(body: Body, frame: int, rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    count = len(body.positions_m)
    if count == 1:
        return np.zeros(3), np.zeros(3)
    i1, i0 = min(frame + 1, count - 1), max(frame - 1, 0)
    seconds = (i1 - i0) / rate_hz
    a, b = body.quaternions[i1], body.quaternions[i0] * [1, -1, -1, -1]
    w = a[0] * b[0] - a[1:] @ b[1:]
    q = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    if w < 0:
        w, q = -w, -q
    size = np.sqrt(q @ q)
    spin = q / size * 2 * np.arctan2(size, w) / seconds if size > 0 else np.zeros(3)
    return (body.positions_m[i1] - body.positions_m[i0]) / seconds, spin


def displacement_m(source: Body, decoded: Body, frame: int) -> float:
    """The largest displacement of a point of the body's field, including one cell around it."""
    supported = np.argwhere((source.forces_n != 0).any(axis=(0, -1)))
    if not len(supported):
        return 0.0
    samples = (supported[:, None] + 2 * np.array(list(np.ndindex(2, 2, 2))) - 1).reshape(-1, 3)
    corners = samples * source.spacing_m + source.origin_m
    source_m, decoded_m = (
        corners @ _rotation(body.quaternions[frame]).T + body.positions_m[frame] for body in (source, decoded)
    )
    return float(_lengths(decoded_m - source_m).max())


def composed_ratio(
    pairs: Sequence[tuple[Body, Body]],
    frame: int,
    lattice: tuple[Sequence[int], Sequence[float], Sequence[float]],
    limits: tuple[float, float, float, float],
    rate_hz: float,
) -> float:
    """Largest |error| / max(F_0, k |F|) of the composed force of a frame, up to the accuracy of float64.

    `pairs` are the source and the decoded version of each body; `lattice` the shape, spacing and origin of
    the samples; `limits` k, F_0, the limit of sums, and the surface damping b. The fields of the source are
    placed at the decoded poses, and move like the poses of the source.
    """
    shape, spacing, origin = lattice
    k, f0_n, force_max_n, damping = limits
    points = np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3) * np.asarray(spacing) + np.asarray(origin)
    sums, added = np.zeros((2, len(points), 3)), np.zeros(len(points))
    is_decidable = np.ones(len(points), bool)
    floor_n = 1e-9 * force_max_n
    for source, decoded in pairs:
        rotation, position = _rotation(decoded.quaternions[frame]), decoded.positions_m[frame]
        r = points - position
        index = (r @ rotation - decoded.origin_m) / decoded.spacing_m
        for total, body in zip(sums, (source, decoded), strict=True):
            body_force = _interpolated(body.at(frame), index)
            size = _lengths(body_force)
            is_decidable &= np.abs(size - floor_n) > _EDGE * floor_n
            force = body_force @ rotation.T
            if damping:
                velocity, spin = _velocity(body, frame, rate_hz)
                force = force + damping * (velocity + np.cross(spin, r))
            force[size <= floor_n] = 0.0
            total += force
            added += _lengths(force)
            # a position in a cell is exact to some 1e-13 of the lattice's extent
            added += 1e-2 * np.abs(body.at(frame)).max(initial=0.0) * (size > 0)
    size = _lengths(sums)
    cut = np.where(size > force_max_n, force_max_n / np.maximum(size, 1e-300), 1.0)
    a, b = (sums * cut[..., None]).astype(np.float32).astype(np.float64)
    allowed = np.maximum(f0_n, k * _lengths(a))
    error = np.maximum(_lengths(b - a) - _SUMS * added - _FLOAT32 * _lengths(a) - 2e-45, 0.0)
    return _largest(error[is_decidable], allowed[is_decidable])
