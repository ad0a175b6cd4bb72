"""Counts hands on springs that swing by themselves on real media that do not change.

    python bench/bench_swings.py [--quick] [--hands N]

Hands (0.2 kg on a spring of 200 N/m with 2 N s/m) are pressed into a frame of coded media: a terrain, depth
pictures of TUM fr1_rpy and ICL-NUIM (nw 6 and 7), and bodies that have fallen. They push with 0.5 to 3 N from
seeded points of the surface, up to 60 degrees off its normal, where many slide to an edge or a hollow. A hand
swings if its force still changes by more than 50 mN, peak to peak, in the fifth second. `--hands` press into
each medium, without friction and with mu 0.3, rendered by the player's choice ("auto", a proxy) and by the
field.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import rests
from hands import Hands, Spring
from machine import SHARED, Bar, Figures, at_most, bench
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, HapticMedium
from touchfield.perception.hand_motion import points_on_surface
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.spec import RenderSpec, wall_of
from touchfield.sources.options import SourceOptions

TICKS, LATE, PRESS, SEED = 5000, 4000, 400, 107
OUTSIDE_M, LEAST_N, MOST_N, TILT_DEG, SWING_N = 0.006, 0.5, 3.0, 60.0, 0.05
FRICTIONS = (0.0, 0.3)


def frame_of(source: str, spec: EncodeSpec, index: int) -> Callable[[], ForceField]:
    """Return how to get a frame of a source after coding."""
    return lambda: rests.coded(source, spec)[index]


def media() -> dict[str, Callable[[], ForceField]]:
    """Return how to make each field that the data allow."""
    found: dict[str, Callable[[], ForceField]] = {
        "terrain": lambda: prepare("sample:terrain", EncodeSpec()).medium[0]
    }
    for name, folder in rests.SCENES.items():
        if (SHARED / folder).is_dir():
            for nw in (6, 7):
                spec = EncodeSpec(frames=(5, 6), nw=nw)
                found[f"{name}, nw {nw}"] = frame_of(str(SHARED / folder), spec, 0)
    fallen = EncodeSpec(
        nw=7, frames=(140, 142), source=SourceOptions(rate_hz=100.0), touch=TouchSpec(effort="fast")
    )
    for name in ("falling-4", "falling-7"):
        found[name] = frame_of(f"sample:{name}", replace(fallen, representation="voxel"), 1)
    return found


def presses(field: ForceField, count: int, rng: np.random.Generator) -> tuple[Any, Any]:
    """Return starts of hands, float64 [hands, 3], and the ends of their springs, [hands, ticks, 3]."""
    wall = wall_of(field)
    assert wall is not None
    points_m = points_on_surface(field, count, rng)
    normals = field.sample_n(points_m).astype(np.float64)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    across = np.cross(normals, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    tilt = np.radians(rng.uniform(0.0, TILT_DEG, count))[:, None]
    outwards = np.cos(tilt) * normals + np.sin(tilt) * across
    depth_m = rng.uniform(LEAST_N, MOST_N, (count, 1)) * (1 / Spring().n_per_m + 1 / wall.stiffness_n_per_m)
    starts_m = points_m + OUTSIDE_M * outwards
    u = np.clip(np.arange(TICKS) / PRESS, 0.0, 1.0)[None, :, None]
    way = u**3 * (10 - 15 * u + 6 * u**2)
    return starts_m, starts_m[:, None] - way * ((OUTSIDE_M + depth_m) * outwards)[:, None]


def measure(hands: int) -> Figures:
    """Press hands into all media."""
    rows: Figures = {}
    for name, make in media().items():
        field = make()
        medium = HapticMedium.from_frames([field], 30.0)
        starts_m, goals_m = presses(field, hands, np.random.default_rng(SEED))
        for friction in FRICTIONS:
            row: Figures = {"hands": hands}
            for render in ("auto", "field"):
                crowd = Hands(medium, spec=RenderSpec(render=render, friction=friction, up="lattice"))
                run = crowd.run(goals_m, TICKS, Spring(), starts_m)
                swings_n = np.linalg.norm(np.ptp(run.force_n[:, LATE:], axis=1), axis=1)
                row[f"{render}_swinging"] = int((swings_n > SWING_N).sum())
                row[f"{render}_largest_mn"] = 1e3 * float(swings_n.max())
            rows[f"{name}, mu {friction:g}"] = row
    return {"rows": rows, "sums": sums(rows)}


def sums(rows: Figures) -> Figures:
    """Return how many hands swing on all media, by friction and rendering."""
    found: Figures = {}
    for friction in FRICTIONS:
        some = [row for name, row in rows.items() if name.endswith(f"mu {friction:g}")]
        keys = ("hands", "auto_swinging", "field_swinging")
        found[f"mu {friction:g}"] = {key: sum(row[key] for row in some) for key in keys}
    return found


def bars(figures: Figures) -> list[Bar]:
    """Require that fewer hands swing than with the field alone, and none with friction."""
    without, rubbed = figures["sums"]["mu 0"], figures["sums"]["mu 0.3"]
    return [
        at_most("no friction: hands that swing, over those with the field alone",
                without["auto_swinging"] / max(1, without["field_swinging"]), 0.5),
        at_most("mu 0.3: hands that swing", rubbed["auto_swinging"], 0),
    ]  # fmt: skip


if __name__ == "__main__":
    bench("swings", __doc__, measure, bars, hands=(300, 20))
