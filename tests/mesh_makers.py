"""Small meshes, and the lattice around them."""

from __future__ import annotations

import math

import numpy as np

from touchfield.medium import Grid
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene

Mesh = tuple[np.ndarray, np.ndarray]

CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def cube(low: float = 0.0, high: float = 1.0) -> Mesh:
    """An axis-aligned cube whose triangles face outwards; 8 vertices."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    return low + corners * (high - low), CUBE_FACES


def measured(
    scene: MeshScene, grid: Grid, band_m: float, low_m: float | None = None
) -> tuple[np.ndarray, ...]:
    """Points [n, 3], signed distances and directions of the samples with a force, by a law nonzero
    in the band.
    """
    law = ForceProfile(((-band_m if low_m is None else low_m, band_m, 4.0, 1 / band_m),))
    field = scene.field(0, grid, law)
    forces = field.vectors_n().astype(float)
    amplitude = np.linalg.norm(forces, axis=1)
    return grid.to_m(field.positions()), (amplitude - 4) * band_m, forces / amplitude[:, None]


def distance_to(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """The minimal distance to any triangle: to its sides, or to its plane where the foot lies within."""
    best = np.full(len(points), np.inf)
    for corners in mesh[0][mesh[1]]:
        for i in range(3):
            best = np.minimum(best, segment_distance(corners[i], corners[(i + 1) % 3], points))
        sides = (corners[1:] - corners[0]).T
        normal = np.cross(*sides.T)
        if np.linalg.norm(normal) <= 1e-9 * np.linalg.norm(sides[:, 0]) * np.linalg.norm(sides[:, 1]):
            continue
        u, v = np.linalg.pinv(sides) @ (points - corners[0]).T
        height = np.abs((points - corners[0]) @ (normal / np.linalg.norm(normal)))
        best = np.where((u >= 0) & (v >= 0) & (u + v <= 1), np.minimum(best, height), best)
    return best


def segment_distance(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> np.ndarray:
    along = b - a
    share = np.clip((points - a) @ along / max(along @ along, 1e-300), 0, 1)
    return np.linalg.norm(points - a - share[:, None] * along, axis=1)


def winding(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """The sum of signed solid angles (Van Oosterom and Strackee), in whole spheres."""
    total = np.zeros(len(points))
    for triangle in mesh[0][mesh[1]]:
        a, b, c = (triangle[i] - points for i in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        top = np.einsum("ij,ij->i", a, np.cross(b, c))
        bottom = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        total += 2 * np.arctan2(top, bottom)
    return total / (4 * math.pi)


def together(*meshes: Mesh) -> Mesh:
    first = np.cumsum([0, *(len(v) for v, _ in meshes)])
    return np.concatenate([v for v, _ in meshes]), np.concatenate([f + a for (_, f), a in zip(meshes, first)])


def inverted(mesh: Mesh) -> Mesh:
    return mesh[0], mesh[1][:, ::-1]


def all_points(grid: Grid) -> np.ndarray:
    return grid.to_m(np.argwhere(np.ones(grid.shape, bool)))
