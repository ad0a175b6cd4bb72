"""`AnalyticScene`: simple shapes as a scene, from Python or a ``.toml`` file. Their fields are exact, so that
others are compared with them.

F = f(phi) n with phi and n from `touchfield.sources.shapes.shapes`, evaluated brick by brick in float64
wherever a bound of phi allows a force.

From a ``.toml`` file::

    axes = "x right, y up, z towards the viewer"   # optional
    rate_hz = 30.0                                 # optional
    combine = "sum"                                # or "union"; optional

    [[shape]]
    kind = "sphere"                                # or another of `touchfield.sources.shapes.shapes.SHAPES`
    center_m = [0.0, 0.0, 0.0]
    radius_m = 0.05

The other keys of a shape are the parameters of its class in `touchfield.sources.shapes.shapes`.
"""

from __future__ import annotations

import copy
import dataclasses
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Bools, Float64s
from touchfield.errors import InvalidArgument, SourceError, as_source_error, require_one_of, require_positive
from touchfield.json_values import JsonValue
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.field import field_of_points
from touchfield.medium.pose_track import checked_rotation
from touchfield.sources.laws import ForceProfile
from touchfield.sources.poses import read_text
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Y_AXES, Scene, find_bricks_by_sphere
from touchfield.sources.shapes.shapes import SHAPES, Plane, Shape, checked_triple
from touchfield.sources.shapes.thicken import thicken_shape, thickness_m
from touchfield.sources.thin_walls import MinThickness, ThinWall

_MAX_BYTES: Final = 1 << 24

COMBINATIONS: Final = ("sum", "union")


class AnalyticScene(Scene):
    """One or several static shapes.

    combine : str; "sum": the forces of the shapes are added. "union": only the nearest surface acts, phi
        being the smallest of all and n its normal; exact outside, while within an overlap phi is that of the
        most deeply penetrated shape, not the distance to the joint surface.

    Raises `InvalidArgument` if there is no shape or `combine` is another word.
    """

    is_solid = True
    _motion: tuple[Float64s, Float64s] | None = None  # R and t of `moved`

    def __init__(
        self, shapes: Sequence[Shape], combine: str = "sum", axes: str = UP_Y_AXES, rate_hz: float = 30.0
    ) -> None:
        if not shapes:
            raise InvalidArgument("shapes", "none", "at least one")
        require_one_of("combine", combine, COMBINATIONS)
        require_positive(rate_hz=rate_hz)
        self.shapes, self.combine = tuple(shapes), combine
        self.axes, self.rate_hz = axes, float(rate_hz)

    def bounds_m(self) -> Float64s:
        """Return the box of the shapes.

        A plane counts as its point, or, if there are only planes, as a square of one metre.
        """
        boxes = [shape.box_m() for shape in self.shapes if not isinstance(shape, Plane)]
        planes = [shape for shape in self.shapes if isinstance(shape, Plane)]
        boxes += [np.array([p.point_m, p.point_m], np.float64) if boxes else p.box_m() for p in planes]
        box = np.stack([np.min(boxes, axis=(0, 1)), np.max(boxes, axis=(0, 1))])
        if self._motion is None:
            return box
        middle, reach = self.placed(box.mean(axis=0)), np.abs(self._motion[0]) @ (np.ptp(box, axis=0) / 2)
        return np.stack([middle - reach, middle + reach])

    def moved(self, rotation: Float64s, shift_m: Float64s) -> AnalyticScene:
        """See `Scene.moved`.

        Raises `InvalidArgument` if `rotation` is not a rotation, or a number is not finite.
        """
        other, matrix = copy.copy(self), checked_rotation(rotation)
        turn, shift = self._motion or (np.eye(3), np.zeros(3))
        other._motion = matrix @ turn, matrix @ shift + checked_triple("shift_m", shift_m)
        return other

    def thickened(self, rule: MinThickness) -> tuple[Scene, tuple[ThinWall, ...]]:
        """See `Scene.thickened`: plates and rods, each by itself."""
        rule = rule if self._motion is None else rule.rotated(self._motion[0])
        shapes, thin = list(self.shapes), []
        for n, shape in enumerate(self.shapes):
            thick = thicken_shape(shape, [*self.shapes[:n], *self.shapes[n + 1 :]], rule)
            if thick is not None:
                name = f"{type(shape).__name__.lower()} {n + 1}"
                thin.append(ThinWall(name, thickness_m(shape), thickness_m(thick)))
                shapes[n] = thick
        if not thin:
            return self, ()
        other = copy.copy(self)
        other.shapes = tuple(shapes)
        return other, tuple(thin)

    def placed(self, points_m: Float64s) -> Float64s:
        """Apply the motion of `moved` to points of the shapes, metres, float64 [..., 3]."""
        if self._motion is None:
            return points_m
        return np.asarray(points_m @ self._motion[0].T + self._motion[1])

    def _to_local(self, points_m: Float64s) -> Float64s:
        if self._motion is None:
            return points_m
        return np.asarray((points_m - self._motion[1]) @ self._motion[0])

    def forces_n(self, points_m: Float64s, profile: ForceProfile) -> Float64s:
        """Return forces, newtons, float64 [n, 3], at points in metres, float64 [n, 3]."""
        local_m = self._to_local(points_m)
        of_shapes = (shape.signed_distance_and_normal(local_m) for shape in self.shapes)
        phi, normal = map(np.stack, zip(*of_shapes, strict=True))
        if self.combine == "union":
            nearest = phi.argmin(axis=0)[None]
            phi = np.take_along_axis(phi, nearest, axis=0)
            normal = np.take_along_axis(normal, nearest[..., None], axis=0)
        forces: Float64s = (profile(phi)[..., None] * normal).sum(axis=0)
        return forces if self._motion is None else forces @ self._motion[0].T

    def _forces_of_bricks_n(self, points_m: Float64s, profile: ForceProfile) -> Float64s:
        """Return what `forces_n` does, at the samples of whole bricks.

        A shape is evaluated only in bricks that its forces may reach, or where it may be the nearest one.
        """
        local_m = self._to_local(points_m).reshape(-1, BRICK**3, 3)
        first, last = local_m[:, 0], local_m[:, -1]  # opposite corners
        radius_m = float(np.linalg.norm(last - first, axis=1).max(initial=0.0)) / 2 * (1 + 1e-9)
        ranges = [shape.distance_range((first + last) / 2, radius_m) for shape in self.shapes]
        forces: Float64s = np.zeros_like(local_m)
        if self.combine == "union":
            nearest_high = np.min([high for _, high in ranges], axis=0)
            phi, normal = np.full(local_m.shape[:2], np.inf), np.zeros_like(local_m)
            for shape, (low, _) in zip(self.shapes, ranges, strict=True):
                some = np.flatnonzero(~(low > nearest_high))
                other_phi, other_normal = _evaluated(shape, local_m[some])
                is_nearer = other_phi < phi[some]
                phi[some] = np.where(is_nearer, other_phi, phi[some])
                normal[some] = np.where(is_nearer[..., None], other_normal, normal[some])
            forces = profile(phi)[..., None] * normal
        else:
            for shape, (low, high) in zip(self.shapes, ranges, strict=True):
                some = np.flatnonzero(_may_act(profile, low, high))
                phi, normal = _evaluated(shape, local_m[some])
                forces[some] += profile(phi)[..., None] * normal
        vectors: Float64s = forces.reshape(-1, 3)
        return vectors if self._motion is None else vectors @ self._motion[0].T

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """See `Scene.field`; `frame` is ignored."""

        def may_act(centres: Float64s, radius_m: float) -> Bools:
            local_m = self._to_local(centres)
            ranges = (shape.distance_range(local_m, radius_m) for shape in self.shapes)
            return np.asarray(np.any([_may_act(profile, low, high) for low, high in ranges], axis=0))

        return field_of_points(
            grid,
            find_bricks_by_sphere(may_act, grid),
            lambda points: self._forces_of_bricks_n(points, profile),
        )


def _may_act(profile: ForceProfile, low: Float64s, high: Float64s) -> Bools:
    """Return whether a profile may have a force at distances from `low` to `high`, bool [n]."""
    acting = [piece for piece in profile.pieces if piece[2] or piece[3]]
    pieces = [(low <= piece_high) & (high > piece_low) for piece_low, piece_high, *_ in acting]
    return np.asarray(np.any(pieces, axis=0)) if pieces else np.zeros(len(low), np.bool_)


def _evaluated(shape: Shape, bricks_m: Float64s) -> tuple[Float64s, Float64s]:
    """Return distances [n, 512] and normals [n, 512, 3] at points of bricks."""
    phi, normal = shape.signed_distance_and_normal(bricks_m.reshape(-1, 3))
    return phi.reshape(bricks_m.shape[:2]), normal.reshape(bricks_m.shape)


# -- from a file -------------------------------------------------------------------------------------------
def read_toml(path: Path, expected: str) -> JsonValue:
    """Read a TOML file of up to 16 MiB.

    Raises `SourceError` if it cannot be read, is longer, or is not TOML.
    """
    try:
        return JsonValue(tomllib.loads(read_text(path, _MAX_BYTES)), str(path))
    except (ValueError, RecursionError) as error:
        mend = "Check that place, or copy the file again."
        raise SourceError(str(path), f"no TOML ({error})", expected, mend) from error


def tables(table: JsonValue, name: str) -> list[JsonValue]:
    """Return the tables ``[[name]]``, named "name 1" and so on.

    Raises `SourceError` if there is none.
    """
    value = table.value.get(name)
    if not isinstance(value, list) or not value or not all(isinstance(entry, dict) for entry in value):
        raise SourceError(f"{table.file}: {name}", "no list of tables", f"at least one [[{name}]] table")
    return [JsonValue(entry, table.file, f"{name} {i}") for i, entry in enumerate(value, 1)]


def read_analytic(path: Path, rate_hz: float | None = None) -> AnalyticScene:
    """Read a scene of shapes; `rate_hz` is used if the file has none.

    Raises `SourceError` if the file cannot be read, is not TOML, or a key is unknown, missing or invalid.
    """
    table = read_toml(path, "a TOML file with [[shape]] tables")
    table.only(("axes", "rate_hz", "combine", "shape"))
    shapes = [shape_of_table(entry) for entry in tables(table, "shape")]
    axes, combine = table.at("axes", UP_Y_AXES).text(), table.at("combine", "sum").text()
    rate = table.at("rate_hz", rate_hz or 30.0).number()
    with as_source_error(f"{path}: "):
        return AnalyticScene(shapes, combine, axes, rate)


def shape_of_table(entry: JsonValue) -> Shape:
    """Return the shape of a table: its kind, and the parameters of that kind.

    Raises `SourceError`, which names the key, if the kind or a parameter is unknown, missing or invalid.
    """
    kind = entry.at("kind").text(tuple(SHAPES))
    fields = dataclasses.fields(SHAPES[kind])  # type: ignore[arg-type]
    entry.only(("kind", *(f.name for f in fields)))
    values: dict[str, Any] = {}
    for f in fields:
        if f.name in entry.members() or f.default is dataclasses.MISSING:
            value = entry.at(f.name)
            is_list = isinstance(value.value, list)
            values[f.name] = (
                tuple(number.number() for number in value.elements()) if is_list else value.number()
            )
    try:
        with as_source_error(f"{entry.file}: {entry.location}."):
            return SHAPES[kind](**values)
    except (TypeError, ValueError) as error:
        raise entry.wrong("a number for a list, or a list for a number", f"the keys of a {kind}") from error


KIND = SourceKind(
    "analytic",
    "shapes with a formula, from a .toml file",
    lambda path: path.suffix.lower() == ".toml" and path.is_file(),
    lambda path, options: read_analytic(path, options.rate_hz),
)
