"""Steps of the force on a hand that rests on a desk and in a room while they change, of `auto` and the field.

Hands rest 3 mm behind seeded points of the surface of TUM fr1_rpy and ICL-NUIM livingroom1, 24 frames looped.
They are fixed or on a spring (0.2 kg, 200 N/m, 2 N s/m), and each is rendered by the field and by the
player's choice ("auto", a proxy). After 0.9 s, when the hand has come to rest, "step" is the largest change
of the force from one tick of 1 ms to the next, mN, and "band" its part from 40 to 400 Hz, mN rms; both are
the worst of all points.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import touchfield as tf
from machine import SHARED, Bar, Figures, at_most
from touchfield.medium import HapticMedium
from touchfield.perception.hand_motion import in_band, points_on_surface
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.spec import RenderSpec

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "render"))
from seam_makers import Played, steps_n

SCENES = {"TUM desk": "rgbd_tum_fr1_rpy", "ICL room": "rgbd_iclnuim_livingroom1"}
DEPTH_M, OUTSIDE_M, PRESS_S, QUIET_S, TICKS = 0.003, 0.008, 0.1, 0.9, 1600
MAX_RATIO, LEAST_STEP_MN, LEAST_BAND_MN = 2.0, 5.0, 0.5
"""Of `auto` to the field; below these figures of the field nothing is compared: no hand feels them."""


def press(medium: HapticMedium, point: Any, outwards: Any, is_spring: bool, render: str) -> Any:
    """Return the forces on a hand that was pressed behind a point and rests there, float64 [ticks, 3]."""
    played = Played(medium, loop=True, spec=RenderSpec(render=render, up="lattice"))
    start, end = point + OUTSIDE_M * outwards, point - DEPTH_M * outwards
    ways = np.clip(np.arange(TICKS) / (1e3 * PRESS_S), 0.0, 1.0)[:, None]
    goals = start + ways * (end - start)
    forces = (
        played.on_spring(start, goals, TICKS)[0]
        if is_spring
        else np.array([played.tick(goal) for goal in goals])
    )
    return forces[round(1e3 * QUIET_S) :]


def rests(points: int, lattices: int) -> Figures:
    """Measure hands at rest on the scenes that are there, on `lattices` lattices from nw 6."""
    rows: Figures = {}
    for name, folder in SCENES.items():
        for nw in range(6, 6 + lattices) if (SHARED / folder).is_dir() else ():
            with TemporaryDirectory() as place:
                path = Path(place) / "scene.touch"
                tf.encode(str(SHARED / folder), path, EncodeSpec(frames=(0, 24), nw=nw))
                coded = tf.decode(path)
                medium = HapticMedium.from_frames([*coded], coded.rate_hz, coded.axes)
            first = medium[0]
            where = points_on_surface(first, points, np.random.default_rng(5))
            normals = first.sample_n(where)
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            for is_spring in (False, True):
                row: Figures = {}
                for render in ("field", "auto"):
                    played = [
                        press(medium, *at, is_spring, render) for at in zip(where, normals, strict=True)
                    ]
                    row[f"{render}_step"] = max(1e3 * float(steps_n(forces).max()) for forces in played)
                    bands = (np.sqrt((in_band(forces, 1000.0) ** 2).sum(axis=1).mean()) for forces in played)
                    row[f"{render}_band"] = 1e3 * max(map(float, bands))
                rows[f"{name}, nw {nw}, {'spring' if is_spring else 'fixed'}"] = row
    return rows


def bars(rows: Figures) -> list[Bar]:
    """Require that `auto` steps and hums by at most twice as much as the field."""
    found = []
    for name, row in rows.items():
        for key, least in (("step", LEAST_STEP_MN), ("band", LEAST_BAND_MN)):
            ratio = row[f"auto_{key}"] / max(row[f"field_{key}"], least)
            found.append(at_most(f"{name}: {key} of auto over the field's", ratio, MAX_RATIO))
    return found
