"""Draws the polyhedra whose vertices are the directions of a codebook, in three dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.paper.directions import Codebook

__all__ = ["Shell", "draw_shells", "face_angles_deg"]

_LIGHT = np.array([0.6, 0.35, 0.72])


@dataclass(frozen=True)
class Shell:
    """One polyhedron of a picture.

    Attributes
    ----------
    codebook : Codebook
    radius : float
    colours : str or float [f, 4]
        One colour, shaded by a lamp over the shoulder; or one for each face.
    opened_to : (float, float, float) or None
        The faces on this side are left out.
    """

    codebook: Codebook
    radius: float = 1.0
    colours: str | NDArray[np.float64] = "#56b4e9"
    opened_to: tuple[float, float, float] | None = None


def draw_shells(panel: Any, shells: Sequence[Shell]) -> None:
    """Draw polyhedra on 3-D axes of matplotlib; all faces together, so that the nearer hide the farther."""
    from matplotlib.colors import to_rgba
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    faces, colours = [], []
    for shell in shells:
        corners = shell.codebook.vertices[shell.codebook.faces] * shell.radius
        normals = corners.mean(axis=1) / shell.radius
        if isinstance(shell.colours, str):
            light = 0.75 + 0.25 * np.clip(normals @ (_LIGHT / np.linalg.norm(_LIGHT)), -0.8, 1)
            own = np.array(to_rgba(shell.colours)) * np.stack(
                [light, light, light, np.ones_like(light)], axis=1
            )
        else:
            own = shell.colours
        kept = np.ones(len(corners), np.bool_)
        if shell.opened_to is not None:
            kept = normals @ np.array(shell.opened_to) <= 0
        faces.append(corners[kept])
        colours.append(own[kept])
    panel.add_collection3d(
        Poly3DCollection(
            np.concatenate(faces), facecolors=np.concatenate(colours), edgecolors="0.15", linewidths=0.4
        )
    )


def face_angles_deg(codebook: Codebook) -> NDArray[np.float64]:
    """The angle from the corners of each face to the direction in it that is farthest from them,
    float64 [f].
    """
    a, b, c = (codebook.vertices[codebook.faces[:, i]] for i in range(3))
    centre = np.cross(b - a, c - a)
    across = np.linalg.norm(np.cross(centre, a), axis=1)
    angles: NDArray[np.float64] = np.degrees(np.arctan2(across, np.abs((centre * a).sum(axis=1))))
    return angles
