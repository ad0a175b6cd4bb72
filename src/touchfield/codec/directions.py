"""Direction codebooks: the vertices of subdivided polyhedra (paper section 4.2, eq. 7, figures 3 and 8).

The paper quantises a direction to the vertex of a "concentric tessellated icosahedron" that is most likely, which
is the one with the largest dot product: so under isotropic Gaussian noise, and under any noise that depends on the
angle alone.

Departures. 92 is an icosahedral number, but 258 is none: it is an octahedron whose triangles are split in four three
times. Both are here, `ico3` and `octa3`; the default is `ico5`, 252 vertices, which cost one bit less than 258 when
written plainly and cover better.

===============  ========================================================================  =====================
name             vertices                                                                  is
===============  ========================================================================  =====================
ico1 .. ico20    10 f^2 + 2: 12, 42, 92, 162, 252, ... 4002                                icosahedron, each edge
                                                                                           in f parts of equal
                                                                                           angle
ico3-flat ..     the same                                                                  in f parts of equal
                                                                                           length, then projected
octa1 .. octa5   4^(f+1) + 2: 18, 66, 258, 1026, 4098                                      octahedron, split in
                                                                                           four f times, each time
                                                                                           projected
===============  ========================================================================  =====================

"Equal angle" places a vertex at sum_i sin(w b_i) v_i, normalised, with w the angle of an edge and b_i the
barycentric coordinates; it covers better from f = 4 on (for f = 3 it is 0.06 degrees worse). All coordinates come
from + - * / and the square root alone, and are rounded to multiples of 2^-40, so that every machine has the same
codebook. The order is ascending in x, then y, then z; the opposite of vertex i is vertex N - 1 - i.

The paper models the direction mask as Delta_V = k |dx| with dx the difference of two forces, which is empty: every
difference exceeds it. Corrected: Delta_V = k |x|; two forces of equal amplitude at an angle theta differ by the chord
2 sin(theta / 2) |x|, and `coarsest_for_mask` gives the smallest icosahedron whose covering radius keeps it.

Eq. 7's product codebook {r_i g_j}: the nearest codeword has the direction of the largest dot product and then the
level nearest to |x| cos(theta), not to |x| (`Codebook.amplitude_for_direction`). That has the least mean squared
error; quantising |x| itself keeps the amplitude's mask, and is the default of the coders.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.codec.stage import Claim
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float32s = NDArray[np.float32]
    Float64s = NDArray[np.float64]
    Indices = NDArray[np.uint16]

__all__ = ["DEFAULT", "LARGEST_FREQUENCY", "Codebook", "coarsest_for_mask", "codebook_names"]

DEFAULT = "ico5"

LARGEST_FREQUENCY = {"ico": 20, "octa": 5}

_GRAIN = 2.0**-40
_NAME = re.compile(r"(ico|octa)([1-9][0-9]?)(-flat)?")


@dataclass(frozen=True, eq=False)
class Codebook:
    """Directions to choose from. Made by `Codebook.get`; two of the same name are the same object.

    Attributes
    ----------
    name : str
    vertices : float64 [n, 3]
        Unit vectors, ascending in x, y, z.
    faces : int32 [f, 3]
        Triangles between the vertices, as the subdivision made them.
    """

    name: str
    vertices: Float64s
    faces: NDArray[np.int32]

    @staticmethod
    def get(name: str = DEFAULT) -> Codebook:
        """The codebook of that name; the table above lists them.

        Raises
        ------
        InvalidArgument
            If there is none.
        """
        return _made(name)

    def __len__(self) -> int:
        return len(self.vertices)

    @cached_property
    def vertices_float32(self) -> Float32s:
        """The vertices as the decoder uses them, float32 [n, 3]."""
        rounded = self.vertices.astype(np.float32)
        rounded.flags.writeable = False
        return rounded

    @cached_property
    def covering_radius_deg(self) -> float:
        """The largest angle between any direction and its vertex, degrees.

        The largest circumscribed circle of a face: exact where the faces are the Delaunay triangles of the
        vertices, never too small otherwise.
        """
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        centre = np.cross(b - a, c - a)
        across = np.linalg.norm(np.cross(centre, a), axis=1)
        return math.degrees(np.arctan2(across, np.abs((centre * a).sum(axis=1))).max())

    @property
    def claim(self) -> Claim:
        """The covering radius, and the rounding of vertices to float32."""
        return Claim("angle", math.radians(self.covering_radius_deg) + 2.0**-22, low=np.nextafter(0.0, 1.0))

    @cached_property
    def _cells(self) -> tuple[int, Any]:
        from touchfield.codec.kernels import directions as kernels

        side = 128 if len(self) <= 700 else 256
        return side, kernels.cells(self.vertices, side)

    def nearest(self, vectors: ArrayLike) -> Indices:
        """The vertex nearest to each vector: the largest dot product in float64.

        Parameters
        ----------
        vectors : float32 [m, 3]
            Of any length.

        Returns
        -------
        uint16 [m]
            Of vertices equally near, the first; 0 for the zero vector.

        Raises
        ------
        InvalidArgument
            If the shape is another, or a vector is not finite.
        """
        from touchfield.codec.kernels import directions as kernels

        x = _vectors(vectors)
        side, table = self._cells
        indices, good = kernels.nearest(x, self.vertices, table, side)
        if not good:
            raise InvalidArgument("vectors", "one that is not finite", "finite components")
        return indices

    def amplitude_for_direction(self, vectors: ArrayLike, directions: Indices) -> Float32s:
        """|x| cos(theta), the amplitude whose level makes the nearest codeword of the product codebook.

        Parameters
        ----------
        vectors : float32 [m, 3]
        directions : uint16 [m]
            What `nearest` gave.

        Returns
        -------
        float32 [m]
            The dot product with the vertex; 0 where it is negative.

        Raises
        ------
        InvalidArgument
            If the shapes do not agree.
        CorruptFile
            If there is no such vertex.
        """
        from touchfield.codec.kernels import directions as kernels

        x = _vectors(vectors)
        if directions.shape != (len(x),):
            raise InvalidArgument("directions", f"shape {directions.shape}", f"({len(x)},)")
        self._check(directions)
        return kernels.dots(x, self.vertices, np.ascontiguousarray(directions, np.uint16))

    # -- as a coding stage --------------------------------------------------------------------------------

    def encode(self, values: Float32s) -> Indices:
        """See `nearest`."""
        return self.nearest(values)

    def decode(self, symbols: Indices) -> Float32s:
        """The vertices of indices [m], float32 [m, 3].

        Raises
        ------
        CorruptFile
            If there is no such vertex.
        """
        self._check(symbols)
        return self.vertices_float32[symbols]

    def _check(self, symbols: Indices) -> None:
        if len(symbols) and int(symbols.max()) >= len(self):
            raise CorruptFile("direction", str(int(symbols.max())), f"below {len(self)}, as {self.name} has")

    def to_bytes(self) -> bytes:
        """The name; everything else follows from it."""
        name = self.name.encode("ascii")
        return bytes([len(name)]) + name

    @staticmethod
    def from_bytes(data: bytes) -> Codebook:
        """The codebook that `to_bytes` wrote; it must fill `data`.

        Raises
        ------
        TruncatedFile, CorruptFile
            If the bytes end too early, or name no codebook.
        """
        if not data or len(data) < 1 + data[0]:
            raise TruncatedFile("direction codebook", f"{len(data)} bytes", "a length and a name")
        name = data[1:].decode("ascii", "replace")
        if len(data) > 1 + data[0] or name not in codebook_names():
            raise CorruptFile("direction codebook", repr(name), f"one of {_SUMMARY}")
        return Codebook.get(name)


_SUMMARY = "ico1 to ico20, ico3-flat to ico20-flat, octa1 to octa5"


@cache
def codebook_names() -> tuple[str, ...]:
    """The names of all codebooks; the registry of direction stages."""
    ico, octa = (range(1, LARGEST_FREQUENCY[family] + 1) for family in ("ico", "octa"))
    return (
        *(f"ico{f}" for f in ico),
        *(f"ico{f}-flat" for f in ico if f > 2),  # up to 2 the two are the same
        *(f"octa{f}" for f in octa),
    )


def coarsest_for_mask(k: float) -> Codebook:
    """The smallest of ico1 to ico20 whose directions alone keep the mask: 2 sin(covering radius / 2) <= k.

    Raises
    ------
    InvalidArgument
        If `k` is smaller than the finest codebook keeps (0.0366).
    """
    for frequency in range(1, LARGEST_FREQUENCY["ico"] + 1):
        codebook = Codebook.get(f"ico{frequency}")
        chord = 2 * math.sin(math.radians(codebook.covering_radius_deg) / 2)
        if chord <= k:
            return codebook
    raise InvalidArgument("k", repr(k), f"{chord:.4f} or more, which the finest codebook keeps")


def _vectors(vectors: ArrayLike) -> Float32s:
    x = np.ascontiguousarray(vectors, np.float32)
    if x.ndim != 2 or x.shape[1] != 3:
        raise InvalidArgument("vectors", f"shape {x.shape}", "[m, 3]")
    return x


# -- making the polyhedra -------------------------------------------------------------------------------------


@cache
def _made(name: str) -> Codebook:
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None or name not in codebook_names():
        raise InvalidArgument("directions", repr(name), f"one of {_SUMMARY}")
    family, count, flat = match[1], int(match[2]), match[3] is not None
    corners = _split_octahedron(count) if family == "octa" else _split_icosahedron(count, flat)
    grains = np.rint(corners.reshape(-1, 3) / _GRAIN).astype(np.int64)
    whole, index = np.unique(grains, axis=0, return_inverse=True)
    vertices: Float64s = whole.astype(np.float64) * _GRAIN
    faces = index.reshape(-1, 3).astype(np.int32)
    vertices.flags.writeable = faces.flags.writeable = False
    return Codebook(name, vertices, faces)


def _normalised(points: Float64s) -> Float64s:
    """Points [..., 3] on the unit sphere, the squares added in one fixed order."""
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    unit: Float64s = points / np.sqrt(x * x + y * y + z * z)[..., None]
    return unit


def _split_octahedron(times: int) -> Float64s:
    """Corners of the triangles, float64 [8 * 4^times, 3, 3]."""
    axes = np.eye(3)
    signs = np.array([(a, b, c) for a in (1, -1) for b in (1, -1) for c in (1, -1)], np.float64)
    corners = signs[:, :, None] * axes
    for _ in range(times):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = _normalised(a + b), _normalised(b + c), _normalised(c + a)
        quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return corners


def _icosahedron() -> Float64s:
    """Corners of the 20 faces, float64 [20, 3, 3]."""
    golden = (1 + math.sqrt(5)) / 2
    one = [(0.0, a, b * golden) for a in (1, -1) for b in (1, -1)]
    points = _normalised(np.array([p[-s:] + p[:-s] for s in range(3) for p in one]))
    neighbours = points @ points.T > 0.4  # neighbours have 1 / sqrt 5, all others less
    faces = [t for t in combinations(range(12), 3) if all(neighbours[i, j] for i, j in combinations(t, 2))]
    corners: Float64s = points[np.array(faces)]
    return corners


def _split_icosahedron(frequency: int, flat: bool) -> Float64s:
    """Corners of the triangles, float64 [20 f^2, 3, 3]."""
    weights = np.arange(frequency + 1) / frequency
    if not flat:
        weights = _sine(1.1071487177940904 * weights)  # atan 2, the angle of an edge

    def rows(i: int, j: int) -> int:  # the place of barycentric (i, j) in the list below
        return i * (frequency + 1) - i * (i - 1) // 2 + j

    barycentric = np.array(
        [(i, j, frequency - i - j) for i in range(frequency + 1) for j in range(frequency + 1 - i)]
    )
    upward = [(rows(i, j), rows(i + 1, j), rows(i, j + 1)) for i in range(frequency) for j in range(frequency - i)]
    downward = [
        (rows(i + 1, j), rows(i + 1, j + 1), rows(i, j + 1))
        for i in range(frequency - 1)
        for j in range(frequency - 1 - i)
    ]
    a, b, c = (weights[barycentric[:, axis], None] for axis in range(3))
    faces = _icosahedron()
    points = _normalised(a * faces[:, 0, None] + b * faces[:, 1, None] + c * faces[:, 2, None])
    corners: Float64s = points[:, np.array(upward + downward)].reshape(-1, 3, 3)
    return corners


def _sine(angles: Float64s) -> Float64s:
    """The sine of angles up to 1.2, by its series: the C library's may differ in the last bit between machines."""
    square = angles * angles
    total = np.ones_like(angles)
    for n in range(26, 0, -2):
        total = 1 - total * square / (n * (n + 1))
    return angles * total
