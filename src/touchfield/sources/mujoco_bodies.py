"""The bodies of a MuJoCo model as scenes: what of them can be touched, in the frame of each.

What is touched is what collides, as in MuJoCo itself: a geom with contype or conaffinity, or of an explicit contact
pair. Geoms that only look (both zero) are left out; where a model has no others, those of the groups 0 to 2 are
taken, which MuJoCo's viewers show. A mesh is touched as it is, although MuJoCo collides its convex hull.

The geoms of a body that have a formula are one body, their union. Each mesh or height field of a body that has other
geoms too is a body of its own, "body/geom", with the same track: where they overlap, forces are added.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError, blamed_on
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.mesh_scene import MeshScene
from touchfield.sources.mesh_surface import joined
from touchfield.sources.scene import UP_Z_AXES, Scene
from touchfield.sources.shapes import SHAPES, Shape, moved

Float64s = NDArray[np.float64]

_SHOWN_GROUPS: Final = 3
_HERE: Final = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Piece:
    """A body of the model, or a part of it."""

    name: str
    body_id: int  # of the MuJoCo body whose frame the scene is in
    scene: Scene


@dataclass
class _Parts:
    """The geoms of a body, sorted by how they are evaluated."""

    shapes: list[Shape] = field(default_factory=list)
    meshes: list[tuple[int, Float64s, NDArray[np.int32]]] = field(default_factory=list)


def pieces_of(mujoco: Any, model: Any, where: str, shell: str = "auto") -> tuple[list[Piece], tuple[str, ...]]:
    """Touchable pieces of a compiled model, in the order of its bodies, and notes.

    Raises `SourceError` if nothing of it can be touched, or a mesh is at fault.
    """
    chosen, notes = _touchable(model)
    parts: dict[int, _Parts] = {}
    left_out = int(model.nflex) + int(model.nskin)
    for geom in chosen:
        own = parts.setdefault(int(model.geom_bodyid[geom]), _Parts())
        with blamed_on(f"{where}: {_name(mujoco, model, mujoco.mjtObj.mjOBJ_GEOM, geom, 'geom')}: "):
            shape = _shape(mujoco, model, geom)
        triangles = None if shape else _triangles(mujoco, model, geom)
        if shape:
            own.shapes.append(shape)
        elif triangles:
            own.meshes.append((geom, *triangles))
        else:
            left_out += 1
    if left_out:
        notes += (f"Left out, as neither a rigid shape nor a mesh (SDF, flex, skin): {left_out}.",)
    pieces = [piece for body, own in sorted(parts.items()) for piece in _pieces(mujoco, model, body, own, shell)]
    if not pieces:
        expected = "a rigid geom: sphere, capsule, ellipsoid, cylinder, box, plane, mesh or hfield"
        raise SourceError(where, "nothing that can be touched", expected)
    return _with_names_apart(pieces), notes


def _touchable(model: Any) -> tuple[list[int], tuple[str, ...]]:
    collides = (np.array(model.geom_contype) != 0) | (np.array(model.geom_conaffinity) != 0)
    collides[np.array(model.pair_geom1, int)] = True
    collides[np.array(model.pair_geom2, int)] = True
    if collides.any():
        count = int((~collides).sum())
        note = f"Left out, as they only look (contype and conaffinity 0): {count} geoms."
        return [int(g) for g in np.flatnonzero(collides)], (note,) if count else ()
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


def _triangles(mujoco: Any, model: Any, geom: int) -> tuple[Float64s, NDArray[np.int32]] | None:
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


def _mesh(model: Any, which: int) -> tuple[Float64s, NDArray[np.int32]]:
    first, count = int(model.mesh_vertadr[which]), int(model.mesh_vertnum[which])
    begin, faces = int(model.mesh_faceadr[which]), int(model.mesh_facenum[which])
    vertices = np.array(model.mesh_vert[first : first + count], np.float64)
    return joined(vertices, np.array(model.mesh_face[begin : begin + faces], np.int32))


def _height_field(model: Any, which: int) -> tuple[Float64s, NDArray[np.int32]]:
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


def _pieces(mujoco: Any, model: Any, body: int, parts: _Parts, shell: str) -> list[Piece]:
    name = _name(mujoco, model, mujoco.mjtObj.mjOBJ_BODY, body, "body")
    pieces: list[Piece] = []
    if parts.shapes:
        pieces.append(Piece(name, body, AnalyticScene(parts.shapes, "union", UP_Z_AXES)))
    is_alone = not parts.shapes and len(parts.meshes) == 1
    for geom, vertices, triangles in parts.meshes:
        part = name if is_alone else f"{name}/{_name(mujoco, model, mujoco.mjtObj.mjOBJ_GEOM, geom, 'geom')}"
        pieces.append(Piece(part, body, MeshScene(vertices, triangles, shell=shell, name=part)))
    return pieces


def _name(mujoco: Any, model: Any, kind: Any, number: int, word: str) -> str:
    return mujoco.mj_id2name(model, kind, number) or f"{word} {number}"


def _with_names_apart(pieces: list[Piece]) -> list[Piece]:
    taken: set[str] = set()
    apart = []
    for piece in pieces:
        name, number = piece.name, 2
        while name in taken:
            name, number = f"{piece.name} ({number})", number + 1
        taken.add(name)
        apart.append(Piece(name, piece.body_id, piece.scene))
    return apart
