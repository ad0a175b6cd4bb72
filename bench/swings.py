"""Counts hands on springs that swing by themselves beside edges, where nothing moves and nothing rubs.

Sixty hands (0.2 kg, 200 N/m, 2 N s/m) are pressed 6 mm behind the surface of a heap of 24 boxes on 64^3
samples, without friction and with mu 0.3. `--points` of 20 make one heap. A hand swings if it still moves by
more than 50 um to either side after 3.6 s. Each heap is rendered by the player's choice ("auto", a proxy) and
by the field.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from hands import Hands, Spring
from machine import Bar, Figures, at_most
from touchfield.medium import HapticMedium
from touchfield.render.spec import RenderSpec

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "render"))
from heap_makers import behind_surface, heap_of_boxes

HANDS, TICKS, REST, SWING_M = 60, 4000, 3600, 0.05e-3
WAYS = {
    "auto": ("auto", 0.0),
    "field": ("field", 0.0),
    "auto, mu 0.3": ("auto", 0.3),
    "field, mu 0.3": ("field", 0.3),
}
"""Each way to render, and its friction."""
POINTS_A_HEAP = 20
"""So that 200 points, the setting of other tables, are ten heaps."""


def swings(points: int) -> Figures:
    """Return for each way to render how many hands swing, and by how much at most, mm."""
    heaps = max(1, points // POINTS_A_HEAP)
    half_m: dict[str, list[float]] = {name: [] for name in WAYS}
    for seed in range(heaps):
        field = heap_of_boxes(seed)
        starts_m, goals_m = behind_surface(field, HANDS)
        medium = HapticMedium.from_frames([field], 30.0)
        for name, found in half_m.items():
            render, friction = WAYS[name]
            crowd = Hands(medium, spec=RenderSpec(render=render, friction=friction, up="lattice"))
            run = crowd.run(goals_m[:, None], TICKS, Spring(), starts_m)
            extents = np.ptp(run.position_m[:, REST:], axis=1)
            found += (np.linalg.norm(extents, axis=1) / 2).tolist()
    return {
        name: {
            "hands": len(found),
            "swinging": int(np.count_nonzero(np.array(found) > SWING_M)),
            "largest_mm": 1e3 * max(found),
        }
        for name, found in half_m.items()
    }


def bars(figures: Figures) -> list[Bar]:
    """Require that no more hands swing with the proxy than with the field."""
    return [
        at_most(
            f"hands that swing beside edges, {friction}",
            figures[f"auto{ending}"]["swinging"],
            figures[f"field{ending}"]["swinging"],
        )
        for friction, ending in (("no friction", ""), ("mu 0.3", ", mu 0.3"))
    ]
