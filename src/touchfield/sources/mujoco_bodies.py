"""The bodies of a MuJoCo model as scenes: what of them can be touched, in the frame of each.

What is touched is what collides, as in MuJoCo itself: a geom with contype or conaffinity, or of an explicit contact
pair. Geoms that only look (both zero) are left out; where a model has no others, those of the groups 0 to 2 are
taken, which MuJoCo's viewers show. A mesh is touched as it is, although MuJoCo collides its convex hull.

The geoms of a body that have a formula are one body, their union. Each mesh or height field of a body that has other
geoms too is a body of its own, "body/geom", with the same track: where they overlap, forces are added.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from itertools import chain, count
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s, Int32s
from touchfield.errors import SourceError, blamed_on
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.mesh_scene import MeshScene
from touchfield.sources.mesh_surface import joined
from touchfield.sources.scene import UP_Z_AXES, Scene
from touchfield.sources.shapes import SHAPES, Shape, moved

_SHOWN_GROUPS: Final = 3
_HERE: Final = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Piece:
    """A body of the model, or a part of it."""

    name: str
    body_id: int  # of the MuJoCo body whose frame the scene is in
    scene: Scene


def pieces_of(mujoco: Any, model: Any, where: str, shell: str = "auto") -> tuple[list[Piece], tuple[str, ...]]:
    """Touchable pieces of a compiled model, in the order of its bodies, and notes.

    Raises `SourceError` if nothing of it can be touched, or a mesh is at fault.
    """
    chosen, notes = _touchable(model)
    # of each body: its shapes, and geom, vertices and triangles of its meshes
    parts: defaultdict[int, tuple[list[Shape], list[tuple[int, Float64s, Int32s]]]]
    parts = defaultdict(lambda: ([], []))
    left_out = int(model.nflex) + int(model.nskin)
    for geom in chosen:
        shapes, meshes = parts[int(model.geom_bodyid[geom])]
        with blamed_on(f"{where}: {_name(model.geom(geom), 'geom')}: "):
            shape = _shape(mujoco, model, geom)
        triangles = None if shape else _triangles(mujoco, model, geom)
        if shape:
            shapes.append(shape)
        elif triangles:
            meshes.append((geom, *triangles))
        else:
            left_out += 1
    if left_out:
        notes += (f"Left out, as neither a rigid shape nor a mesh (SDF, flex, skin): {left_out}.",)
    pieces: list[Piece] = []
    for body, (shapes, meshes) in sorted(parts.items()):
        name = _name(model.body(body), "body")
        if shapes:
            pieces.append(Piece(name, body, AnalyticScene(shapes, "union", UP_Z_AXES)))
        is_alone = not shapes and len(meshes) == 1
        for geom, vertices, faces in meshes:
            part = name if is_alone else f"{name}/{_name(model.geom(geom), 'geom')}"
            pieces.append(Piece(part, body, MeshScene(vertices, faces, shell=shell, name=part)))
    if not pieces:
        expected = "a rigid geom: sphere, capsule, ellipsoid, cylinder, box, plane, mesh or hfield"
        raise SourceError(where, "nothing that can be touched", expected)
    return _with_names_apart(pieces), notes


def _touchable(model: Any) -> tuple[list[int], tuple[str, ...]]:
    collides = (np.array(model.geom_contype) != 0) | (np.array(model.geom_conaffinity) != 0)
    collides[np.array(model.pair_geom1, int)] = True
    collides[np.array(model.pair_geom2, int)] = True
    if collides.any():
        left_out = int((~collides).sum())
        note = f"Left out, as they only look (contype and conaffinity 0): {left_out} geoms."
        return [int(g) for g in np.flatnonzero(collides)], (note,) if left_out else ()
    shown = np.array(model.geom_group) < _SHOWN_GROUPS
    note = "No geom collides: those that the viewers show (groups 0 to 2) are touched."
    return [int(g) for g in np.flatnonzero(shown)], (note,) if shown.any() else ()


def _shape(mujoco: Any, model: Any, geom: int) -> Shape | None:
    """The shape of a geom in its body's frame; None where it has no formula."""
    name = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    a, b, c = (float(s) for s in model.geom_size[geom])
    sizes: dict[str, tuple[Any, ...]] = {
        "sphere": (a,), "capsule": (a, b), "cylinder": (a, b), "plane": ((0.0, 0.0, 1.0),),
        "ellipsoid": ((a, b, c),), "box": ((a, b, c),),
    }  # fmt: skip
    if name not in sizes:
        return None
    shape = SHAPES[name](_HERE, *sizes[name])  # type: ignore[call-arg]
    rotation, shift = _frame(mujoco, model, geom)
    is_placed = shift.any() or not np.array_equal(rotation, np.eye(3))
    return moved(shape, rotation, shift) if is_placed else shape


def _triangles(mujoco: Any, model: Any, geom: int) -> tuple[Float64s, Int32s] | None:
    """The triangles of a mesh or height field in its body's frame; None where a geom is neither."""
    kinds, kind = mujoco.mjtGeom, int(model.geom_type[geom])
    which = int(model.geom_dataid[geom])
    if kind == kinds.mjGEOM_MESH:
        vertices, triangles = _mesh(model, which)
    elif kind == kinds.mjGEOM_HFIELD:
        vertices, triangles = _height_field(model, which)
    else:
        return None
    rotation, shift = _frame(mujoco, model, geom)
    return vertices @ rotation.T + shift, triangles


def _frame(mujoco: Any, model: Any, geom: int) -> tuple[Float64s, Float64s]:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.array(model.geom_quat[geom], np.float64))
    return matrix.reshape(3, 3), np.array(model.geom_pos[geom], np.float64)


def _mesh(model: Any, which: int) -> tuple[Float64s, Int32s]:
    first, number = int(model.mesh_vertadr[which]), int(model.mesh_vertnum[which])
    begin, faces = int(model.mesh_faceadr[which]), int(model.mesh_facenum[which])
    vertices = np.array(model.mesh_vert[first : first + number], np.float64)
    return joined(vertices, np.array(model.mesh_face[begin : begin + faces], np.int32))


def _height_field(model: Any, which: int) -> tuple[Float64s, Int32s]:
    """A height field as a closed mesh: its surface, four walls and a bottom.

    Each cell is cut from its corner of least x and y to that of most, as MuJoCo's collision does.
    """
    rows, columns = int(model.hfield_nrow[which]), int(model.hfield_ncol[which])
    half_x, half_y, top, base = (float(s) for s in model.hfield_size[which])
    first = int(model.hfield_adr[which])
    height = top * np.array(model.hfield_data[first : first + rows * columns], np.float64)
    y, x = np.meshgrid(np.linspace(-half_y, half_y, rows), np.linspace(-half_x, half_x, columns), indexing="ij")
    surface = np.stack([x.reshape(-1), y.reshape(-1), height], axis=-1)
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.reshape(-1) for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    # round the edge, anticlockwise seen from above
    edge = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    below = rows * columns + np.arange(len(edge))
    middle = np.full(len(edge), rows * columns + len(edge))
    ahead, below_ahead = np.roll(edge, -1), np.roll(below, -1)
    foot = surface[edge] * (1.0, 1.0, 0.0) - (0.0, 0.0, base)
    triangles = [(a, b, c), (a, c, d), (edge, below, below_ahead), (edge, below_ahead, ahead)]
    triangles.append((middle, below_ahead, below))
    faces = np.concatenate([np.stack(three, axis=-1) for three in triangles])
    return np.concatenate([surface, foot, [[0.0, 0.0, -base]]]), faces.astype(np.int32)


def _name(element: Any, word: str) -> str:
    return str(element.name or f"{word} {element.id}")


def _with_names_apart(pieces: list[Piece]) -> list[Piece]:
    names: dict[str, None] = {}
    for piece in pieces:
        tries = chain([piece.name], (f"{piece.name} ({number})" for number in count(2)))
        names[next(name for name in tries if name not in names)] = None
    return [replace(piece, name=name) for piece, name in zip(pieces, names, strict=True)]
