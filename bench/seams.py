"""Steps of the force where a medium does not continue: the end of a loop, a seek, the start of a segment.

Bodies fall and come to rest (`sample:falling-7`, 100 frames a second), as objects and as coded voxels. Hands
rest at seeded points in the last frames, where the force is 0.6 to 2.2 N, fixed or on a spring (0.2 kg,
200 N/m, 2 N s/m). Meanwhile the player seeks, a segment starts, and the loop ends, whereupon the bodies are
elsewhere; then the fixed hand goes back into contact by a seek. Each is rendered by the field and by the
player's choice ("auto").

A step is |F| of the change from one tick of 1 ms to the next, mN. "field_own" is the largest one of the field
while the whole medium plays once, without a seam; "band" is the part of the force from 40 to 400 Hz around
the end of the loop, mN rms.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import touchfield as tf
from hands import Hands, Spring
from machine import Bar, Figures, at_most
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import HapticMedium, HapticScene
from touchfield.perception.hand_motion import in_band
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.sampler import FieldSampler
from touchfield.render.spec import RenderSpec
from touchfield.sources.options import SourceOptions

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "render"))
from seam_makers import SPRING_N_PER_M, steps_n

LEAST_N, MOST_N = 0.6, 2.2
START_S, END_S, AROUND_MS = 1.2, 2.0, (3, 140)
TICKS, LATE, MAX_RATIO = 1600, 12, 2.0
SEEK, BACK_S = 250, 1.25
"""The tick of a seek in contact, and the media time that it goes to; `LATE` ticks later its frames come."""
SEGMENT, LOOP = (round(SEEK + LATE + 1e3 * (time_s - BACK_S)) for time_s in (1.5, END_S))
"""Ticks at which a segment starts and the loop ends."""
RETURN, RETURN_S = 1300, 1.8
"""The tick at which the fixed hand goes from nothing into contact, and its media time."""


def media(nw: int) -> dict[str, HapticMedium | HapticScene]:
    """Return the falling bodies as objects, and as coded voxels."""
    spec = EncodeSpec(nw=nw, source=SourceOptions(rate_hz=100.0), touch=TouchSpec(effort="fast"))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "voxels.touch"
        tf.encode("sample:falling-7", path, replace(spec, representation="voxel"))
        voxels = tf.decode(path)
        held = HapticMedium.from_frames([*voxels], voxels.rate_hz, voxels.axes)
        held = replace(held, segments=voxels.segments)
    scene = prepare("sample:falling-7", replace(spec, representation="object")).objects
    assert scene is not None
    return {"objects": scene, "voxels": held}


def resting_points(medium: HapticMedium | HapticScene, count: int) -> tuple[Any, Any]:
    """Return seeded points in contact in the last frames, and the forces there, both float64 [count, 3]."""
    low, high = medium.grid.box_m
    points = np.random.default_rng(1).uniform(low, high, (200_000, 3))
    forces = FieldSampler(medium).force_n(END_S - 0.05, points).astype(np.float64)
    sizes = np.linalg.norm(forces, axis=1)
    found = np.flatnonzero((sizes > LEAST_N) & (sizes < MOST_N))[:count]
    return points[found], forces[found]


def rest(
    medium: HapticMedium | HapticScene, points: Any, forces: Any, is_spring: bool, **options: Any
) -> Any:
    """Return the forces on hands that rest at points, newtons, float64 [hands, ticks, 3]."""
    render, is_whole = options["render"], options.get("is_whole", False)
    spec = RenderSpec(render=render, up="lattice", blend=not is_whole)
    start_s, ticks = (0.0, round(1e3 * END_S)) if is_whole else (START_S, TICKS)
    hands = Hands(medium, LATE, start_s=start_s, loop=not is_whole, spec=spec)
    seeks = {} if is_whole else {SEEK: BACK_S} if is_spring else {SEEK: BACK_S, RETURN: RETURN_S}
    goals = points - forces / SPRING_N_PER_M if is_spring else points
    return hands.run(goals[:, None], ticks, Spring() if is_spring else None, points, seeks).force_n


def around(tick: int) -> slice:
    """Return the ticks around a seam."""
    before, after = AROUND_MS
    return slice(tick - before, tick + after)


def seams(points: int, nw: int = 6) -> Figures:
    """Measure the steps at seams, and of the field elsewhere."""
    rows: Figures = {}
    for name, medium in media(nw).items():
        positions, forces = resting_points(medium, points)
        for is_spring in (False, True):
            whole = rest(medium, positions, forces, is_spring, render="field", is_whole=True)
            own = max(steps_n(felt)[AROUND_MS[1] :].max() for felt in whole)
            windows = {"loop": [LOOP], "seek": [SEEK] if is_spring else [SEEK, RETURN], "segment": [SEGMENT]}
            for render in ("field", "auto"):
                row = dict.fromkeys((*windows, "band"), 0.0) | {"field_own": 1e3 * float(own)}
                for played in rest(medium, positions, forces, is_spring, render=render):
                    steps = 1e3 * steps_n(played)
                    for key, ticks in windows.items():
                        row[key] = max(row[key], *(float(steps[around(tick)].max()) for tick in ticks))
                    band = in_band(played, 1000.0)
                    band = band[around(LOOP - (len(played) - len(band)) // 2)]
                    row["band"] = max(row["band"], 1e3 * float(np.sqrt((band**2).sum(axis=1).mean())))
                rows[f"{name}, {'spring' if is_spring else 'fixed'}, {render}"] = row
    return rows


def bars(rows: Figures) -> list[Bar]:
    """Require that a seam steps by at most twice as much as the field does without one."""
    return [
        at_most(f"{name}: step at a {kind} over the field's own", row[kind] / row["field_own"], MAX_RATIO)
        for name, row in rows.items()
        for kind in ("loop", "seek", "segment")
    ]
