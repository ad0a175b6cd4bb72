"""A tool is a sphere or a mesh that touches the field in place of a single point. This file samples its
surface as points with normals, and writes them into the memory of a receiver.

The force on a tool is the sum over its points of s max(0, -n . F / |F|) F, with F the field's force at the
point and n the outward normal of the tool there. Each piece of the tool's surface is thus weighted by the
area that it presents to the force (McNeely, Puterbaugh and Troy 1999 and Barbic and James 2007 use normals
similarly), and a force from behind, as at the far side of a thin plate, does not pull the tool through.

The weight s of a point is four times its fraction of the tool's area: averaged over all directions, a convex
body presents a quarter of its area (Cauchy). The weights of a convex tool in a uniform force therefore add up
to 1 in the mean over its orientations; for a sphere they always do. The force on a small sphere is that on a
point, whatever its number of points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s, Int64s, lengths_of
from touchfield.errors import InvalidArgument, require_between, require_up_to
from touchfield.medium.field import frozen

if TYPE_CHECKING:
    from touchfield.render.block import Memory

MAX_POINTS: Final = 100_000
SPHERE_POINTS: Final = 1000
_FLOATS_PER_POINT: Final = 6  # position and normal in the tool's axes, float32, by component
_MAX_DISTANCE_M: Final = 10.0
_GOLDEN: Final = (1 + 5**0.5) / 2


@dataclass(frozen=True, eq=False)
class Tool:
    """Points on a surface; each represents the same area.

    Both arrays are float64 [n, 3]: positions in metres from the device's point, in the tool's axes, ordered
    so that neighbours in space are near each other in the list; and outward unit normals. Raises
    `InvalidArgument` if there is no point or there are more than `MAX_POINTS`, shapes differ, a number is not
    finite, a point is farther than 10 m, or a normal is not of unit length.
    """

    points_m: Float64s
    normals: Float64s
    name: str = "tool"

    def __post_init__(self) -> None:
        points, normals = np.array(self.points_m, np.float64), np.array(self.normals, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not 1 <= len(points) <= MAX_POINTS:
            raise InvalidArgument(
                "points_m", f"shape {points.shape}", f"[n, 3] with n from 1 to {MAX_POINTS}"
            )
        if not np.abs(points).max() <= _MAX_DISTANCE_M:
            found, hint = f"{np.abs(points).max():g} m", "Scale a mesh in millimetres by 0.001."
            raise InvalidArgument("points_m", found, f"at most {_MAX_DISTANCE_M:g} m", hint)
        lengths = lengths_of(normals)
        if normals.shape != points.shape or not (np.abs(lengths - 1) < 1e-6).all():
            raise InvalidArgument("normals", f"shape {normals.shape}", f"{points.shape}, each of length 1")
        object.__setattr__(self, "points_m", frozen(points))
        object.__setattr__(self, "normals", frozen(normals))

    def __len__(self) -> int:
        return len(self.points_m)

    @classmethod
    def sphere(cls, radius_m: float, points: int = SPHERE_POINTS) -> Tool:
        """Make a sphere about the device's point, with points on a spiral between the poles."""
        require_up_to(_MAX_DISTANCE_M, radius_m=radius_m)
        require_between(1, MAX_POINTS, points=points)
        n = np.arange(points)
        height = 1 - (2 * n + 1) / points
        radius = np.sqrt(1 - height**2)
        angle = 2 * np.pi * n / _GOLDEN
        normals = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
        normals = normals[_morton_order(normals)]
        return cls(radius_m * normals, normals, f"sphere of {1000 * radius_m:g} mm")

    @classmethod
    def of_triangles(
        cls, vertices_m: Float64s, triangles: NDArray[np.integer], points: int, name: str
    ) -> Tool:
        """Make a tool of points spread evenly over a surface, float64 [n, 3] and int [m, 3].

        Triangles are counter-clockwise from outside; a closed surface that is inside out is reversed. Raises
        `InvalidArgument` if the surface has no area, or the numbers are invalid for a `Tool`.
        """
        require_between(1, MAX_POINTS, points=points)
        a, b, c = (np.asarray(vertices_m, np.float64)[triangles[:, k]] for k in range(3))
        area_vectors = np.cross(b - a, c - a)
        areas = lengths_of(area_vectors)
        if not 0 < areas.sum() < np.inf:
            raise InvalidArgument(name, "a surface without area", "triangles with an area")
        if (a * area_vectors).sum() < 0:  # six times the volume
            area_vectors = -area_vectors
        order = _morton_order((a + b + c) / 3)
        order = order[areas[order] > 0]
        cumulative_areas = np.cumsum(areas[order])
        ranks = np.searchsorted(
            cumulative_areas, (np.arange(points) + 0.5) / points * cumulative_areas[-1]
        ).clip(max=len(order) - 1)
        triangle = order[ranks]
        first = np.searchsorted(ranks, ranks)  # the first point in the same triangle
        n = np.arange(points) - first + 0.5
        u, v = (n * 0.7548776662466927) % 1, (n * 0.5698402909980532) % 1  # Roberts 2018, the plastic number
        u, v = np.where(u + v > 1, 1 - u, u)[:, None], np.where(u + v > 1, 1 - v, v)[:, None]
        positions = a[triangle] + u * (b - a)[triangle] + v * (c - a)[triangle]
        normals = area_vectors[triangle] / areas[triangle][:, None]
        order_in_space = _morton_order(positions)
        return cls(positions[order_in_space], normals[order_in_space], name)


def _morton_order(points: Float64s) -> Int64s:
    """Return the order of points [n, 3] along a Morton curve (Morton 1966), int64 [n].

    Neighbours in space are near each other in this order.
    """
    low = points.min(axis=0)
    step = max(float((points.max(axis=0) - low).max()), 1e-300)
    cells = ((points - low) / step * 1023).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def tool_bytes(tool: Tool | None) -> int:
    """Return the number of bytes that a tool takes in the memory of a receiver."""
    return 0 if tool is None else 4 * _FLOATS_PER_POINT * len(tool)


def write_tool(memory: Memory, offset: int, tool: Tool | None) -> None:
    """Write a tool at an offset; None is a point, which takes no bytes."""
    settings = memory.receiver["settings"]
    settings["tool_offset"], settings["tool_point_count"] = offset, 0 if tool is None else len(tool)
    settings["tool_weight"] = settings["tool_reach_m"] = 0.0
    if tool is None:
        return
    numbers = memory.array(np.float32, offset, _FLOATS_PER_POINT * len(tool))
    numbers[:] = np.concatenate([tool.points_m.T, tool.normals.T]).ravel()
    settings["tool_weight"] = 4.0 / len(tool)
    settings["tool_reach_m"] = 1.000001 * float(lengths_of(tool.points_m).max())
