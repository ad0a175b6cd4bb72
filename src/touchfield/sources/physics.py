"""Scenes of rigid bodies that fall and collide, or that files pose, from a ``.toml`` file (paper section 5.1)::

    [physics]                        # optional, as all its keys; the values here are the defaults
    seconds = 2.0
    rate_hz = 1000.0                 # frames a second; frame i is the state at i / rate_hz
    step_s = 0.001                   # of the simulation
    gravity_m_s2 = [0, 0, -9.81]
    friction = 0.6
    torsional_friction_m = 0.0
    rolling_friction_m = 0.0
    restitution = 0.3                # speed after a bounce over speed before it
    contact_s = 0.008                # length of a bounce, 7 steps or more

    [floor]                          # without this table there is none
    height_m = 0.0
    touchable = true                 # false: bodies fall on it, but it is not felt

    [[body]]
    kind = "box"                     # box, sphere, capsule, cylinder, ellipsoid, superquadric, mesh
    half_extents_m = [0.03, 0.02, 0.01]
    name = "brick"                   # optional, as all below but position_m
    position_m = [0, 0, 0.2]
    rotation_deg = [0, 0, 0]         # about the fixed x, then y, then z axis
    velocity_m_s = [0, 0, 0]
    spin_deg_s = [0, 0, 0]           # about the axes of the scene
    density_kg_m3 = 1000             # or mass_kg
    fixed = false                    # true: it stays where it is

    [[body]]
    kind = "mesh"
    file = "hand.ply"                # and unit_m; or vertices_m and triangles, as lists of three numbers
    poses = "hand.csv"               # in place of position_m and what follows: see touchfield.sources.poses

The other keys of a body are those of its shape, as in `touchfield.sources.analytic_scene`; its middle is the origin
of the body's frame. Axes are x east, y north, z up. A body that a file poses pushes others and is moved by none.
Where nothing is simulated, no MuJoCo is needed, and the scene lasts as long as the pose files.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium.pose_track import PoseTrack
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.body_scene import BodyScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics_model import model_of
from touchfield.sources.physics_table import PhysicsTable, RigidBody, read_physics
from touchfield.sources.poses import quaternion_of_turns, read_pose_csv, track_at_rate
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Z_AXES, Body
from touchfield.sources.shapes import Plane
from touchfield.sources.simulation import frames_of, load_mujoco, simulated
from touchfield.sources.toml_values import read_toml

Poses = tuple[Float64s, Float64s, Float64s]

_SECONDS: Final = 2.0


def open_physics(path: Path, options: SourceOptions) -> BodyScene:
    """Read a scene, simulate it, and give its bodies in motion; ``options`` gives other seconds or another rate.

    Raises `SourceError` if a file is at fault, or the simulation diverges; `MissingExtra` if there is something to
    simulate and MuJoCo is not installed; `InvalidArgument` if that is more poses than are kept.
    """
    table = read_physics(path, anywhere=options.allow_outside)
    rate = options.rate_hz or table.world.rate_hz
    poses = {body.name: read_pose_csv(body.poses) for body in table.bodies if body.poses}
    frames = _frame_count(path, table, poses, options.seconds or table.world.seconds, rate)
    posed = {name: track_at_rate(*rows, rate, frames) for name, rows in poses.items()}
    notes: tuple[str, ...] = ()
    if any(body.is_simulated for body in table.bodies):
        model, ids, told = model_of(load_mujoco(), table, posed, str(path))
        driven = {body_id: posed[body.name] for body, body_id in zip(table.bodies, ids, strict=True) if body.poses}
        tracks, notes = simulated(model, ids, frames, rate, str(path), driven)
        notes = (*told, *notes)
    else:
        tracks = [posed[body.name] if body.poses else _still(body, frames) for body in table.bodies]
    bodies = [Body(one.name, one.scene, track) for one, track in zip(table.bodies, tracks, strict=True)]
    if table.floor and table.floor.touchable:
        plane = Plane((0.0, 0.0, table.floor.height_m), (0.0, 0.0, 1.0))
        bodies.append(Body("floor", AnalyticScene((plane,), "union", UP_Z_AXES), PoseTrack.still(frames)))
    return BodyScene(bodies, rate, UP_Z_AXES, (*_outside(poses, frames / rate, rate), *notes))


def _outside(poses: dict[str, Poses], seconds: float, rate_hz: float) -> tuple[str, ...]:
    """A note for each body whose poses begin after the scene, or go on after its end."""
    notes = []
    for name, (times, _, _) in poses.items():
        first, last = float(times[0]), float(times[-1])
        if first * rate_hz > 1.0:
            notes.append(f"{name} stands still until its first pose, at {min(first, seconds):.6g} s.")
        if last < 0:
            notes.append(f"{name} stands still: its last pose is at {last:.6g} s, and the scene begins at 0.")
        if (last - seconds) * rate_hz > 1.0:
            notes.append(f"{name}: the poses after {seconds:.6g} s are left out (--seconds).")
    return tuple(notes)


def _frame_count(
    path: Path, table: PhysicsTable, poses: dict[str, Poses], seconds: float | None, rate_hz: float
) -> int:
    count = len(table.bodies)
    if seconds is None and len(poses) and not any(body.is_simulated for body in table.bodies):
        last_s = max(float(times[-1]) for times, _, _ in poses.values())
        # the frame at the last pose is one too, but for rounding
        first_s = min(float(times[0]) for times, _, _ in poses.values())
        try:
            return frames_of(str(path), (math.floor(max(last_s, 0.0) * rate_hz + 1e-6) + 1) / rate_hz, rate_hz, count)
        except InvalidArgument as error:
            if first_s < last_s / 2:
                raise
            found = f"poses that begin at {first_s:.6g} s"
            raise InvalidArgument(str(path), found, error.expected, "Let their times begin at 0.") from error
    return frames_of(str(path), _SECONDS if seconds is None else seconds, rate_hz, count)


def _still(body: RigidBody, frames: int) -> PoseTrack:
    still = PoseTrack.still(frames, body.position_m)
    return replace(still, quaternions=np.tile(quaternion_of_turns(body.rotation_deg), (frames, 1)))


def _recognise(path: Path) -> bool:
    if path.suffix.lower() != ".toml" or not path.is_file():
        return False
    try:
        table = read_toml(path, "")
    except SourceError:
        return False  # the next kind that takes .toml will say why
    return "body" in table or "physics" in table


KIND = SourceKind(
    "physics", "rigid bodies that fall, collide or follow pose files, from a .toml file", _recognise, open_physics
)
