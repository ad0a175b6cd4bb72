"""Polyhedra of direction codebooks, drawn in three dimensions."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.directions import Codebook

__all__ = ["draw_polyhedron", "face_angles_deg"]

_LIGHT = np.array([0.6, 0.35, 0.72])


def draw_polyhedron(
    panel: Any,
    codebook: Codebook,
    radius: float = 1.0,
    colour: str = "#56b4e9",
    keep: Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None = None,
    face_colours: NDArray[np.float64] | None = None,
) -> None:
    """Draw the faces of a codebook, shaded by a lamp over the shoulder unless each has a colour of its own.

    Parameters
    ----------
    panel : matplotlib 3-D axes
    codebook : Codebook
    radius : float
    colour : str
    keep : callable, optional
        Which faces to draw, bool [f] of their centres, float64 [f, 3].
    face_colours : float64 [f, 4], optional
        In place of `colour`.
    """
    from matplotlib.colors import to_rgb
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    corners = codebook.vertices[codebook.faces] * radius
    normals = corners.mean(axis=1)
    kept = np.ones(len(corners), np.bool_) if keep is None else keep(normals)
    if face_colours is None:
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        light = 0.62 + 0.38 * np.clip(normals @ (_LIGHT / np.linalg.norm(_LIGHT)), -0.6, 1)
        face_colours = np.clip(np.array(to_rgb(colour)) * light[:, None], 0, 1)
    panel.add_collection3d(
        Poly3DCollection(corners[kept], facecolors=face_colours[kept], edgecolors="0.15", linewidths=0.4)
    )


def face_angles_deg(codebook: Codebook) -> NDArray[np.float64]:
    """The angle from the corners of each face to the direction in it that is farthest from them, float64 [f]."""
    a, b, c = (codebook.vertices[codebook.faces[:, i]] for i in range(3))
    centre = np.cross(b - a, c - a)
    across = np.linalg.norm(np.cross(centre, a), axis=1)
    angles: NDArray[np.float64] = np.degrees(np.arctan2(across, np.abs((centre * a).sum(axis=1))))
    return angles
