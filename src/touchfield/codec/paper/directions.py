"""Direction codebooks of coder `paper`: a force's direction is stored as the number of the nearest vertex of
a subdivided polyhedron (paper section 4.2). This file builds the vertices and finds the nearest one.

The paper (eq. 7, figures 3 and 8) quantises a direction to the most likely vertex of a "concentric
tessellated icosahedron". For noise that depends on the angle only, the most likely vertex is that with the
largest dot product.

Departures. 92 is a number of vertices of a subdivided icosahedron, but 258 is not: it belongs to an
octahedron whose triangles are split in four three times. Both are available, as `ico3` and `octa3`. The
default is `ico5` with 252 vertices, which takes one bit less than 258 at a fixed code length and covers the
sphere better.

============== ================================== ==========================================================
name           vertices                           construction
============== ================================== ==========================================================
ico1 .. ico20  10 f^2 + 2: 12, 42, 92, ... 4002   icosahedron, each edge in f parts of equal angle
octa1 .. octa5 4^(f+1) + 2: 18, 66, 258, ... 4098 octahedron, split in four f times, each time projected
============== ================================== ==========================================================

"Equal angle" places a vertex at sum_i sin(w b_i) v_i, normalised, with w the angle of an edge and b_i the
barycentric coordinates. All coordinates are computed with + - * / and the square root alone and rounded to
multiples of 2^-40, so that every machine has the same codebook. Vertices are in ascending order of x, then y,
then z.

The paper models the direction mask as Delta_V = k |dx| with dx the difference of two forces. No difference
other than zero is within this mask. Corrected: Delta_V = k |x|; two forces of equal amplitude at an angle
theta differ by the chord 2 sin(theta / 2) |x|. In eq. 7 the nearest codeword {r_i g_j} has the level nearest
to |x| cos(theta), not to |x|. The coder quantises |x| itself, which keeps the error of the amplitude within
the mask.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float32s, Float64s, Int32s
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument

DEFAULT: Final = "ico5"

_LARGEST_FREQUENCY: Final = {"ico": 20, "octa": 5}
_GRAIN = 2.0**-40


class _Cells(NamedTuple):
    """Candidates of the nearest vertex for each cell of the six faces of a cube, side * side cells a face."""

    side: int
    first: Int32s  # [6 * side^2 + 1]; where the candidates of each cell start
    candidates: NDArray[np.uint16]  # indices of vertices, ascending within each cell


@dataclass(frozen=True, eq=False)
class Codebook:
    """Codebook of directions; `Codebook.get` returns one object for each name."""

    name: str
    vertices: Float64s  # [n, 3]; unit vectors, ascending in x, y, z
    faces: Int32s  # [f, 3]; triangles between the vertices, as the subdivision made them

    @staticmethod
    @cache
    def get(name: str) -> Codebook:
        """The codebook of a name in the table above; InvalidArgument if there is none."""
        if name not in codebook_names():
            raise InvalidArgument("directions", repr(name), "one of ico1 to ico20, octa1 to octa5")
        corners = (
            _split_octahedron(int(name[4:])) if name.startswith("octa") else _split_icosahedron(int(name[3:]))
        )
        grains = np.rint(corners.reshape(-1, 3) / _GRAIN).astype(np.int64)
        whole, index = np.unique(grains, axis=0, return_inverse=True)
        vertices: Float64s = whole.astype(np.float64) * _GRAIN
        faces = index.reshape(-1, 3).astype(np.int32)
        vertices.flags.writeable = faces.flags.writeable = False
        return Codebook(name, vertices, faces)

    def __len__(self) -> int:
        return len(self.vertices)

    @cached_property
    def vertices_float32(self) -> Float32s:
        """The vertices rounded to float32 [n, 3], as the decoder uses them."""
        vertices = self.vertices.astype(np.float32)
        vertices.flags.writeable = False
        return vertices

    @cached_property
    def covering_radius_deg(self) -> float:
        """Largest angle between a direction and its nearest vertex, degrees.

        This is the angle from the centre of the widest triangle to its corners.
        """
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        centre = np.cross(b - a, c - a)
        across = np.linalg.norm(np.cross(centre, a), axis=1)
        return math.degrees(np.arctan2(across, np.abs((centre * a).sum(axis=1))).max())

    def nearest(self, vectors: ArrayLike) -> NDArray[np.uint16]:
        """Index of the vertex nearest to each vector, uint16 [m].

        The nearest vertex has the largest dot product in float64; of several equally near ones it is the
        first. The index is 0 for the zero vector. `vectors` are float32 [m, 3] of any length; InvalidArgument
        for another shape, or a vector that is not finite.
        """
        from touchfield.codec.paper.kernels import nearest

        x = np.ascontiguousarray(vectors, np.float32)
        if x.ndim != 2 or x.shape[1] != 3 or not np.isfinite(x).all():
            raise InvalidArgument("vectors", f"shape {x.shape}, or one that is not finite", "finite [m, 3]")
        out = np.empty(len(x), np.uint16)
        cells = self._cells
        for_chunks(
            nearest, len(x), x, self.vertices, cells.side, cells.first, cells.candidates, out, chunk=1 << 12
        )
        return out

    @cached_property
    def _cells(self) -> _Cells:
        """The vertices that can be nearest to a direction, by the cell of a cube's face that it crosses."""
        side = 64 if len(self) < 1000 else 32
        centres = (np.arange(side) + 0.5) * 2 / side - 1
        u, v = (offset.ravel() for offset in np.meshgrid(centres, centres, indexing="ij"))
        radius = math.sqrt(2) / side  # of a cell, on the face: on the sphere no two points are farther apart
        counts, candidates = [], []
        for axis in range(3):
            for sign in (-1.0, 1.0):
                face = np.roll(np.stack([np.full_like(u, sign), u, v], axis=1), axis, axis=1)
                products = _normalise(face) @ self.vertices.T
                # of a direction in the cell, at most `radius` from its centre
                reach = np.sqrt(np.maximum(0, 2 - 2 * products.max(axis=1))) + 2 * radius + 1e-6
                cell, vertex = np.nonzero(products >= (1 - reach**2 / 2)[:, None])
                counts.append(np.bincount(cell, minlength=side * side))
                candidates.append(vertex.astype(np.uint16))
        first = np.concatenate([[0], np.cumsum(np.concatenate(counts))]).astype(np.int32)
        return _Cells(side, first, np.concatenate(candidates))


@cache
def codebook_names() -> tuple[str, ...]:
    """The names of all codebooks."""
    return tuple(
        f"{family}{f}" for family, highest in _LARGEST_FREQUENCY.items() for f in range(1, highest + 1)
    )


def _normalise(points: Float64s) -> Float64s:
    """Project points [..., 3] to the unit sphere; squares are added in a fixed order."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    unit: Float64s = points / np.sqrt(x * x + y * y + z * z)[..., None]
    return unit


def _split_octahedron(times: int) -> Float64s:
    """Corners of the triangles of an octahedron that is split `times` times.

    float64 [8 * 4^times, 3, 3].
    """
    signs = np.array([(a, b, c) for a in (1, -1) for b in (1, -1) for c in (1, -1)], np.float64)
    corners = signs[:, :, None] * np.eye(3)
    for _ in range(times):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = _normalise(a + b), _normalise(b + c), _normalise(c + a)
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return corners


def _icosahedron() -> Float64s:
    """Corners of the 20 faces, float64 [20, 3, 3]."""
    golden = (1 + math.sqrt(5)) / 2
    rectangle = [(0.0, a, b * golden) for a in (1, -1) for b in (1, -1)]
    points = _normalise(np.array([p[-s:] + p[:-s] for s in range(3) for p in rectangle]))
    neighbours = points @ points.T > 0.4  # the dot product of neighbours is 1 / sqrt(5), of all others less
    faces = [t for t in combinations(range(12), 3) if all(neighbours[i, j] for i, j in combinations(t, 2))]
    corners: Float64s = points[np.array(faces)]
    return corners


def _split_icosahedron(frequency: int) -> Float64s:
    """Corners of the triangles of a subdivided icosahedron, float64 [20 f^2, 3, 3]."""
    # atan(2) is the angle of an edge
    weights = _sine(1.1071487177940904 * np.arange(frequency + 1) / frequency)
    coordinates = [(i, j, frequency - i - j) for i in range(frequency + 1) for j in range(frequency + 1 - i)]
    vertex_index = {ijk: n for n, ijk in enumerate(coordinates)}
    upward = [(i, j) for i, j, k in coordinates if k > 0]
    triangles = [[(i, j), (i + 1, j), (i, j + 1)] for i, j in upward]
    triangles += [[(i + 1, j), (i + 1, j + 1), (i, j + 1)] for i, j in upward if i + j < frequency - 1]
    index = np.array([[vertex_index[i, j, frequency - i - j] for i, j in corners] for corners in triangles])
    a, b, c = (weights[np.array(coordinates)[:, axis], None] for axis in range(3))
    faces = _icosahedron()
    points = _normalise(a * faces[:, 0, None] + b * faces[:, 1, None] + c * faces[:, 2, None])
    corners: Float64s = points[:, index].reshape(-1, 3, 3)
    return corners


def _sine(angles: Float64s) -> Float64s:
    """Sine of angles up to 1.2, by its series.

    The sine of C libraries may differ in the last bit.
    """
    square = angles * angles
    total = np.ones_like(angles)
    for n in range(26, 0, -2):
        total = 1 - total * square / (n * (n + 1))
    return angles * total
