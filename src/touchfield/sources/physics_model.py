"""A physics scene as a model of MuJoCo.

A contact is a spring and a damper on the relative acceleration (MuJoCo's direct ``solref``) that push and never
pull: it ends where their force is zero. With the damping ratio z, theta = acos z and w the frequency of the spring
alone, that is after T = 2 theta / (w sin theta), and the speed has fallen by exp(-2 z theta / sin theta), the
restitution (Schwager and Poschel, "Coefficient of restitution and linear-dashpot model revisited", 2007); z and w are
solved for. A mesh collides as its convex hull.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s, Int32s
from touchfield.errors import SourceError
from touchfield.medium.pose_track import PoseTrack
from touchfield.sources.mesh_scene import MeshScene
from touchfield.sources.physics_table import PhysicsTable, RigidBody, World
from touchfield.sources.poses import quaternion_of_turns
from touchfield.sources.shapes import Superquadric, rotation_matrix
from touchfield.sources.simulation import START, compiled

_HARD: Final = (0.99, 0.99, 0.001, 0.5, 2.0)
"""Impedance: nearly all of the acceleration at a contact is the spring's and damper's."""

_LEAST_RESTITUTION: Final = 0.02
_MOST_DAMPED: Final = 10.0  # a damping ratio beyond that of the least restitution
_POSED_KG_M3: Final = 1e8  # density of a body that a file poses: nothing that it meets within a frame moves it
_HULL_ROWS: Final = 16
_THINNEST: Final = 1e-5
"""Thickness of a mesh, as a share of its length, below which no hull is made of it that could be trusted."""

_OVERLAP_M: Final = 1e-4


def model_of(
    mujoco: Any, table: PhysicsTable, posed: Mapping[str, PoseTrack], where: str
) -> tuple[Any, list[int], tuple[str, ...]]:
    """The model, the ids of its bodies in the order of the table, and notes.

    `posed` mapping of str to PoseTrack: of the bodies that files pose, by name; `where` str: what to call the scene
    in messages.

    Raises `SourceError` if MuJoCo refuses it, as it does a mesh without volume.
    """
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = table.world.step_s, table.world.gravity_m_s2
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    touch = _contact(table.world)
    if table.floor:
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(type=plane, size=[0, 0, 1], pos=[0, 0, table.floor.height_m], contype=0, **touch)
    start: dict[str, list[float]] = {"qpos": [], "qvel": []}
    notes: tuple[str, ...] = ()
    for number, body in enumerate(table.bodies):
        position, turn = list(body.position_m), quaternion_of_turns(body.rotation_deg)
        if body.name in posed:
            position, turn = list(posed[body.name].positions_m[0]), posed[body.name].quaternions[0]
        is_posed = body.name in posed
        in_model = spec.worldbody.add_body(name=f"b{number}", pos=position, quat=turn, gravcomp=float(is_posed))
        if not body.is_fixed:
            in_model.add_freejoint()
            start["qpos"] += [*position, *turn]
            spin = np.radians(body.spin_deg_s) @ rotation_matrix(body.rotation_deg)  # in the body's own frame
            start["qvel"] += [*body.velocity_m_s, *spin]
        matter = {"density": body.density_kg_m3} if body.mass_kg is None else {"mass": body.mass_kg}
        if is_posed:
            matter = {"density": _POSED_KG_M3}
        own = {**touch, **matter, "contype": int(body.is_simulated)}  # what is not simulated meets only what is
        notes += _add_geom(mujoco, spec, in_model, f"m{number}", body, own)
    spec.add_key(name=START, **start)

    def make() -> tuple[Any, dict[tuple[int, int], float]]:
        model = spec.compile()
        return model, _overlaps(mujoco, model)

    (model, deepest), told = compiled(make, where, "bodies that MuJoCo refuses", "bodies with a volume")
    notes += told
    kind = mujoco.mjtObj.mjOBJ_BODY
    ids = [mujoco.mj_name2id(model, kind, f"b{number}") for number in range(len(table.bodies))]
    name_of = {0: "the floor", **{body_id: body.name for body_id, body in zip(ids, table.bodies, strict=True)}}
    notes += tuple(
        f"{name_of[second]} begins {-1e3 * dist:.2g} mm within {name_of[first]}: it is thrown out."
        for (first, second), dist in deepest.items()
        if dist < -_OVERLAP_M
    )
    return model, ids, notes


def _overlaps(mujoco: Any, model: Any) -> dict[tuple[int, int], float]:
    """The least distance, metres, of each two bodies that meet at the start; deep ones are thrown apart."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    deepest: dict[tuple[int, int], float] = {}
    for contact in data.contact:
        first, second = (int(model.geom_bodyid[geom]) for geom in (contact.geom1, contact.geom2))
        deepest[first, second] = min(deepest.get((first, second), 0.0), float(contact.dist))
    return deepest


def _contact(world: World) -> dict[str, Any]:
    ratio = _damping_ratio(max(world.restitution, _LEAST_RESTITUTION))
    frequency = 2 * _angle_over_sine(ratio) / (world.contact_s or 8 * world.step_s)
    condim = 1 if world.friction == 0 else 6 if world.rolling_friction_m else 4 if world.torsional_friction_m else 3
    return {
        "friction": [world.friction, world.torsional_friction_m, world.rolling_friction_m],
        "condim": condim,
        "solref": [-(frequency**2), -2 * ratio * frequency],
        "solimp": list(_HARD),
    }


def _damping_ratio(restitution: float) -> float:
    """z with exp(-2 z theta / sin theta) = restitution, by bisection."""
    low, high = 0.0, _MOST_DAMPED
    for _ in range(60):
        ratio = (low + high) / 2
        if 2 * ratio * _angle_over_sine(ratio) < -math.log(restitution):
            low = ratio
        else:
            high = ratio
    return low


def _angle_over_sine(ratio: float) -> float:
    """theta / sin theta for theta = acos(ratio), which is imaginary beyond 1."""
    if abs(ratio - 1) < 1e-9:
        return 1.0
    if ratio < 1:
        return math.acos(ratio) / math.sqrt(1 - ratio * ratio)
    return math.acosh(ratio) / math.sqrt(ratio * ratio - 1)


def _add_geom(
    mujoco: Any, spec: Any, made: Any, mesh_name: str, body: RigidBody, properties: dict[str, Any]
) -> tuple[str, ...]:
    """Add what collides for the scene of a body."""
    kinds, scene = mujoco.mjtGeom, body.scene
    mesh: dict[str, Any] = {}
    notes: tuple[str, ...] = ()
    if isinstance(scene, MeshScene):
        points, triangles, exact = _solid(scene)
        mesh = {"userface": triangles.reshape(-1), "inertia": mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX}
        if exact:
            mesh["inertia"] = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
        if not _is_convex(scene):
            notes = (f"{body.name} is not convex: it collides as its convex hull.",)
    else:
        (shape,) = scene.shapes
        if not isinstance(shape, Superquadric):
            size = getattr(shape, "half_extents_m", None)
            size = size or (shape.radius_m, getattr(shape, "half_length_m", 0.0), 0.0)  # type: ignore[attr-defined]
            kind = getattr(kinds, f"mjGEOM_{type(shape).__name__.upper()}")
            made.add_geom(type=kind, size=list(size), **properties)
            return ()
        points = _hull_points(shape)
    _check_thick(body, points)
    spec.add_mesh(name=mesh_name, uservert=points.reshape(-1), **mesh)
    made.add_geom(type=kinds.mjGEOM_MESH, meshname=mesh_name, **properties)
    return notes


def _check_thick(body: RigidBody, points: Float64s) -> None:
    """`SourceError` for a body that is all but flat, as its hull would be."""
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not sizes[-1] > _THINNEST * sizes[0]:
        share = sizes[-1] / max(sizes[0], 1e-300)
        found = f"a body {share:.1g} as thick as it is long"
        raise SourceError(f"{body.where}: size", found, f"{_THINNEST:g} or more")


def _solid(scene: MeshScene) -> tuple[Float64s, Int32s, bool]:
    """Vertices, triangles that face outwards, and whether they enclose a volume."""
    triangles = np.array(scene.surface.triangles)
    volume = scene.surface.volume_m3() if scene.is_closed else 0.0
    if volume < 0:
        triangles = triangles[:, ::-1]
    return np.array(scene.surface.vertices_m), np.ascontiguousarray(triangles), volume != 0


def _is_convex(scene: MeshScene) -> bool:
    from scipy.spatial import ConvexHull, QhullError

    if not scene.is_closed:
        return False
    try:
        hull = float(ConvexHull(scene.surface.vertices_m).volume)
    except QhullError:
        return False
    return abs(hull - abs(scene.surface.volume_m3())) <= 1e-6 * hull


def _hull_points(shape: Superquadric) -> Float64s:
    """Points of a superquadric's surface by its angles, float64 [n, 3]; closest where it is most curved."""
    turns = np.arange(2 * _HULL_ROWS) * (math.pi / _HULL_ROWS)
    along, around = np.meshgrid(np.linspace(-math.pi / 2, math.pi / 2, _HULL_ROWS + 1), turns)
    e1, e2 = shape.exponents

    def power(value: Float64s, exponent: float) -> Float64s:
        raised: Float64s = np.sign(value) * np.abs(np.where(np.abs(value) < 1e-12, 0.0, value)) ** exponent
        return raised

    ring = power(np.cos(along), e1)
    unit = ring * power(np.cos(around), e2), ring * power(np.sin(around), e2), power(np.sin(along), e1)
    points: Float64s = np.unique(np.stack(unit, axis=-1).reshape(-1, 3), axis=0) * np.asarray(shape.half_extents_m)
    return points
