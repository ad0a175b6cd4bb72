"""`MeshData`: what a mesh file holds, before it becomes a scene; and the parts that assemble one."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.errors import SourceError
from touchfield.sources.mesh.surface import weld
from touchfield.sources.scene import UP_Y_AXES

_MAX_TRIANGLES: Final = 10_000_000  # or one per byte of the file: instances may use one mesh many times


class MeshData(NamedTuple):
    """A welded mesh in the units and the axes of its file."""

    vertices: Float64s  # float64 [n, 3]
    triangles: Int32s  # int32 [m, 3]
    notes: tuple[str, ...] = ()
    unit_m: float | None = None  # metres of a unit; None if the file does not state it
    axes: str = UP_Y_AXES


class Placed(NamedTuple):
    """An instance of a mesh at its place."""

    vertices: Float64s  # float64 [n, 3]
    triangles: NDArray[Any]  # integer [m, 3]; fans of polygons
    sizes: Int64s  # int64 [p]; number of consecutive triangles of each polygon
    is_mirrored: bool = False  # if its placement mirrors: its triangles are turned over


def fans(counts: Int64s) -> tuple[Int64s, Int64s]:
    """Divide polygons into triangles, each as a fan from its first corner.

    `counts` int64 [p] are the corners of each polygon, stored one after another. Returns the indices of the
    corners, int64 [m, 3], and the number of triangles of each polygon that has any, int64.
    """
    sizes = np.maximum(counts - 2, 0)
    first = np.repeat(np.cumsum(counts) - counts, sizes)
    after = first + np.arange(1, len(first) + 1) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.stack([first, after, after + 1], axis=1), sizes[sizes > 0]


def require_bounded(where: str, triangles: int, file_bytes: int) -> None:
    """Raise `SourceError` if a file of `file_bytes` has more triangles in its instances than it may."""
    limit = max(_MAX_TRIANGLES, file_bytes)
    if triangles > limit:
        found = f"instances with {triangles:.3g} triangles in {file_bytes} bytes"
        raise SourceError(where, found, f"at most {limit} triangles", "Export fewer instances.")


def join(parts: list[Placed]) -> tuple[Float64s, Int32s]:
    """Join placed meshes and weld them; vertices float64 [n, 3] and triangles int32 [m, 3].

    Raises ValueError if a triangle names a vertex that is not there.
    """
    first, faces = 0, list[NDArray[Any]]()
    for part in parts:
        if len(part.triangles) and not 0 <= part.triangles.min() <= part.triangles.max() < len(part.vertices):
            raise ValueError(f"a face of vertices that are not there; there are {len(part.vertices)}")
        turned = part.triangles[:, [0, 2, 1]] if part.is_mirrored else part.triangles
        faces.append(turned.astype(np.int64) + first)
        first += len(part.vertices)
    vertices = np.concatenate([part.vertices for part in parts])
    return weld(vertices, np.concatenate(faces), np.concatenate([part.sizes for part in parts]))
