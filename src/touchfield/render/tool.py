"""The tool in the hand: points with normals about the device's point, and how they lie in the block.

What a field gives to a tool is the sum over its points of s max(0, -n . F / |F|) F, with F the field's force
at the point and n the outward normal of the tool there. So a piece of the tool's surface counts by the area
that it shows to the force (McNeely, Puterbaugh and Troy 1999 and Barbic and James 2007 take normals
likewise), and what comes from behind, as at the far side of a thin plate, does not pull the tool through.

The share s of a point is four times its part of the tool's area: over all directions, a quarter of a convex
body's area is what it shows (Cauchy). So the weights of a convex tool within one and the same force add up to
1 in the mean over its orientations, and to 1 always for a sphere: a small sphere feels what a point feels,
however many points it is made of.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s, Int64s, lengths_of
from touchfield.errors import InvalidArgument, require_between, require_up_to
from touchfield.medium.field import frozen
from touchfield.render.block import words as W

if TYPE_CHECKING:
    from touchfield.render.block import Memory

MOST_POINTS: Final = 100_000
SPHERE_POINTS: Final = 1000
NUMBERS: Final = 6  # float32 for each point, in rows: place and normal in the tool's axes; behind them `ROOM`
AT_ONCE: Final = 512  # points that are added up at a time
ROOM: Final = 9 * AT_ONCE  # float32 for their places in a field, the force there, and the sum over fields
_LONGEST_M: Final = 10.0
_GOLDEN: Final = (1 + 5**0.5) / 2


@dataclass(frozen=True, eq=False)
class Tool:
    """Points of a surface, each for the same area of it.

    float64 [n, 3] each: places in metres from the device's point, in the tool's axes, neighbours in space
    near each other in the list; outward normals of length 1. `InvalidArgument` if there is no point or there
    are more than `MOST_POINTS`, shapes differ, a number is not finite, a point is farther than 10 m or a
    normal not unit.
    """

    points_m: Float64s
    normals: Float64s
    name: str = "tool"

    def __post_init__(self) -> None:
        points, normals = np.array(self.points_m, np.float64), np.array(self.normals, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not 1 <= len(points) <= MOST_POINTS:
            raise InvalidArgument(
                "points_m", f"shape {points.shape}", f"[n, 3] with n from 1 to {MOST_POINTS}"
            )
        if not np.abs(points).max() <= _LONGEST_M:
            raise InvalidArgument("points_m", f"{np.abs(points).max():g} m", f"at most {_LONGEST_M:g} m")
        lengths = lengths_of(normals)
        if normals.shape != points.shape or not (np.abs(lengths - 1) < 1e-6).all():
            raise InvalidArgument("normals", f"shape {normals.shape}", f"{points.shape}, each of length 1")
        object.__setattr__(self, "points_m", frozen(points))
        object.__setattr__(self, "normals", frozen(normals))

    def __len__(self) -> int:
        return len(self.points_m)

    @classmethod
    def sphere(cls, radius_m: float, points: int = SPHERE_POINTS) -> Tool:
        """A sphere about the device's point, its points on a spiral from pole to pole, evenly."""
        require_up_to(_LONGEST_M, radius_m=radius_m)
        require_between(1, MOST_POINTS, points=points)
        n = np.arange(points)
        height = 1 - (2 * n + 1) / points
        around = np.sqrt(1 - height**2)
        angle = 2 * np.pi * n / _GOLDEN
        normals = np.stack([around * np.cos(angle), around * np.sin(angle), height], axis=1)
        normals = normals[_along_a_curve(normals)]
        return cls(radius_m * normals, normals, f"sphere of {1000 * radius_m:g} mm")

    @classmethod
    def of_triangles(
        cls, vertices_m: Float64s, triangles: NDArray[np.integer], points: int, name: str
    ) -> Tool:
        """Points spread evenly over a surface, float64 [n, 3] and int [m, 3]: each stands for the same area.

        Triangles are counter-clockwise from outside; a closed surface that is inside out is turned.
        `InvalidArgument` if the surface has no area, or the numbers do not make a `Tool`.
        """
        require_between(1, MOST_POINTS, points=points)
        a, b, c = (np.asarray(vertices_m, np.float64)[triangles[:, k]] for k in range(3))
        doubled = np.cross(b - a, c - a)
        areas = lengths_of(doubled)
        if not 0 < areas.sum() < np.inf:
            raise InvalidArgument(name, "a surface without area", "triangles with an area")
        if (a * doubled).sum() < 0:  # six times the volume
            doubled = -doubled
        order = _along_a_curve((a + b + c) / 3)
        order = order[areas[order] > 0]
        ends = np.cumsum(areas[order])
        which = np.searchsorted(ends, (np.arange(points) + 0.5) / points * ends[-1]).clip(max=len(order) - 1)
        at = order[which]
        first = np.searchsorted(which, which)  # the first point in the same triangle
        n = np.arange(points) - first + 0.5
        u, v = (n * 0.7548776662466927) % 1, (n * 0.5698402909980532) % 1  # Roberts 2018, the plastic number
        u, v = np.where(u + v > 1, 1 - u, u)[:, None], np.where(u + v > 1, 1 - v, v)[:, None]
        places = a[at] + u * (b - a)[at] + v * (c - a)[at]
        normals = doubled[at] / areas[at][:, None]
        near = _along_a_curve(places)
        return cls(places[near], normals[near], name)


def _along_a_curve(places: Float64s) -> Int64s:
    """An order in which neighbours in space are near each other (Morton 1966), int64 [n], of places [n, 3]."""
    low = places.min(axis=0)
    step = max(float((places.max(axis=0) - low).max()), 1e-300)
    cells = ((places - low) / step * 1023).astype(np.int64)
    code = np.zeros(len(places), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def tool_words(tool: Tool | None) -> int:
    """Words of the block that a tool takes."""
    return 0 if tool is None else -(-(NUMBERS * len(tool) + ROOM) // 2)


def write_tool(memory: Memory, at: int, tool: Tool | None) -> None:
    """Write a tool at word `at`; None is a point, and needs no room."""
    i8, _, f8, f4 = memory.views
    i8[W.TOOL], i8[W.TOOL_POINTS] = at, 0 if tool is None else len(tool)
    f8[W.TOOL_SHARE] = f8[W.TOOL_REACH] = 0.0
    if tool is None:
        return
    count = 3 * len(tool)
    f4[2 * at : 2 * at + count] = tool.points_m.T.ravel()
    f4[2 * at + count : 2 * at + 2 * count] = tool.normals.T.ravel()
    f8[W.TOOL_SHARE] = 4.0 / len(tool)
    f8[W.TOOL_REACH] = 1.000001 * float(lengths_of(tool.points_m).max())
