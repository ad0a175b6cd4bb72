"""Simulates a hand and a device in closed loop on a wall, and finds when it is stable: limit cycles, energy,
stiffness.

    python bench/bench_stability.py [--quick] [--every N]

The masses of hand and device are one mass, with the damping b of the device and the spring of the hand.
Between the ticks the motion is computed exactly. The device reports its position in steps of its resolution,
and its force acts after a delay of 0 to 2 ticks. The hand starts 10 mm before the wall, presses with 2 N for
at least two seconds, until the oscillation decays no further, and retreats. The hand itself has no damping,
so a decaying oscillation is no limit cycle.

Each way to render is run on all combinations of wall stiffness, damping, delay, resolution and hand; `--every
N` takes every N-th case. The figures are:

* rms, N: force about its mean in the last second of pressing. "cycles" counts the cases above 20 mN.
* held, mJ: energy from the renderer in that second, less the work of the mean force. "drives" counts the
  cases above 0.01 mJ.
* given, mJ: energy that the hand receives in the whole touch, less that lost in the device's damping. "gives"
  counts the cases above 0.01 mJ.
* soft: cases in which Colgate's condition b > K T (1/2 + delay) allows the wall but its stiffness is more
  than 10 % off.
"""

from __future__ import annotations

import ctypes
import itertools
import subprocess
import sys
import time
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from shutil import which
from tempfile import mkdtemp
from typing import Any

import numpy as np
from scipy.linalg import expm

from machine import Bar, Figures, at_least, at_most, bench, leave_out
from touchfield.render.spec import RenderSpec, stability_of

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "render"))
from tick_makers import OMNI, Bench as Bench, wall as wall

from touchfield.medium import Grid

CYCLE_N, ENERGY_J, STIFFNESS_TOLERANCE = 0.020, 1e-5, 0.10
"""Limits of the bars."""
DEVICE_KG, PRESS_N, TICK_S = 0.045, 2.0, 1e-3
MAX_FORCE_N = 12.0
WALLS = (200.0, 500.0, 1000.0, 2000.0)
DAMPINGS = (0.3, 0.5, 1.0, 2.0, 5.0)
DELAYS = (0, 1, 2)
HANDS = tuple(itertools.product((0.05, 0.2, 1.0), (50.0, 300.0, 1000.0)))
RESOLUTIONS = (0.0, 1e-6, 5e-6, 1e-5, 2e-5)
STRONG = replace(OMNI, force_max_n=12.0, force_continuous_n=None)
GRID = Grid((17, 17, 129), (0.01, 0.01, 0.0005), (-0.08, -0.08, -0.048))


class Case(ctypes.Structure):
    """`touch_case` of ``c_stability.c``."""

    _fields_ = (
        ("step", ctypes.c_double * 3 * 2),
        *((name, ctypes.c_double) for name in ("k", "b", "depth_m", "resolution_m")),
        ("delay_ticks", ctypes.c_int64),
    )


@cache
def simulator() -> Any:
    """Compile ``c_stability.c`` and return its function; skip the benchmark without a C compiler."""
    if which("cc") is None:
        leave_out("no C compiler (cc)")
    library = Path(mkdtemp()) / "stability.so"
    options = ("-O3", "-std=c99", "-ffp-contract=off", "-shared", "-fPIC")
    source = Path(__file__).with_name("c_stability.c")
    subprocess.run(["cc", *options, "-o", str(library), str(source), "-lm"], check=True)
    return ctypes.CDLL(str(library)).simulate_touch


def simulate(
    bench: Bench, kg: float, k: float, b: float, depth_m: float, resolution_m: float, delay_ticks: int
) -> tuple[float, ...]:
    """Simulate one touch by a hand of `kg` and spring `k` on a device of damping `b`.

    Returns rms, mean and energy of the last second of pressing, net energy, mean depth and seconds of
    pressing.
    """
    rows = tick_matrix(DEVICE_KG + kg, k, b)[:2]
    step = (ctypes.c_double * 3 * 2)(*((ctypes.c_double * 3)(*row) for row in rows))
    case, result = Case(step, k, b, depth_m, resolution_m, delay_ticks), (ctypes.c_double * 6)()
    memory = ctypes.c_void_p(bench.memory.bytes.ctypes.data)
    simulator()(memory, ctypes.c_int64(bench.frame), ctypes.byref(case), result)
    return tuple(result)


def tick_matrix(kg: float, k: float, b: float) -> Any:
    """Return the transition matrix of a tick, float64 [3, 3].

    Of a mass, a spring and a damper.
    """
    return expm(np.array([[0, 1, 0], [-k / kg, -b / kg, 1 / kg], [0, 0, 0]]) * TICK_S)


def run(render: Any, every: int) -> dict[str, Any]:
    """Run all cases with one way to render.

    `render(bench, K, b, delay, resolution)` sets up the memory block of a case.
    """
    began, rows = time.perf_counter(), []
    for stiffness in WALLS:
        block = Bench(wall(stiffness, MAX_FORCE_N), device=STRONG, grid=GRID)
        for b, delay, resolution, (kg, k) in [*itertools.product(DAMPINGS, DELAYS, RESOLUTIONS, HANDS)][
            ::every
        ]:
            render(block, stiffness, b, delay, resolution)
            depth = PRESS_N * (1 / stiffness + 1 / k)
            result = simulate(block, kg, k, b, depth, resolution, delay)
            rows.append((stiffness, b, delay, resolution, kg, k, *result))
    return summary_of(np.array(rows)) | {"s": time.perf_counter() - began}


def summary_of(rows: Any) -> dict[str, Any]:
    """Summarise all cases of one way to render."""
    stiffness, b, delay = rows.T[:3]
    rms, mean, hold_j, work_j, deep, lasting = rows.T[6:]
    allowed = b > stiffness * TICK_S * (0.5 + delay)
    stiffness_ratio = mean / np.maximum(deep, 1e-9) / stiffness
    off = np.abs(stiffness_ratio - 1) > STIFFNESS_TOLERANCE
    worst = int(rms.argmax())
    return {
        "cases": len(rows),
        "cycles": int((rms > CYCLE_N).sum()),
        "worst_rms_n": float(rms.max()),
        "drives": int((hold_j > ENERGY_J).sum()),
        "worst_held_mj": float(1e3 * hold_j.max()),
        "gives": int((work_j > ENERGY_J).sum()),
        "worst_given_mj": float(1e3 * work_j.max()),
        "allowed": int(allowed.sum()),
        "soft": int((off & allowed).sum()),
        "longest_s": float(lasting.max()),
        "least_felt": float(stiffness_ratio[allowed].min()),
        "worst_case": dict(
            zip(("K", "b", "delay", "resolution", "kg", "k"), rows[worst, :6].tolist(), strict=True)
        ),
    }


def plain(**options: Any) -> Any:
    """Return a way to render that ignores device and medium."""

    def render(bench: Bench, stiffness: float, b: float, delay: int, resolution: float) -> None:
        bench.restart(RenderSpec(**{"damping_n_s_per_m": 0.0, "coupling_n_per_m": 0.0, **options}))

    return render


def passivity_only(bench: Bench, stiffness: float, b: float, delay: int, resolution: float) -> None:
    """Render with the passivity controller only, with the delay known."""
    bench.device = replace(STRONG, delay_ms=1e3 * delay * TICK_S)
    plain(passivity=True)(bench, stiffness, b, delay, resolution)


def auto(
    bench: Bench, stiffness: float, b: float, delay: int, resolution: float, spec: RenderSpec | None = None
) -> None:
    """Render with the settings that the player chooses for the described device."""
    spec = RenderSpec() if spec is None else spec
    described = replace(
        STRONG, inertia_kg=DEVICE_KG, damping_n_s_per_m=b, delay_ms=1e3 * delay * TICK_S,
        resolution_mm=1e3 * resolution, friction_n=None,
    )  # fmt: skip
    bench.device = described
    bench.restart(spec)
    stability = stability_of(described, spec, 0.0, stiffness)
    bench.memory.receiver["settings"]["brake_n_s_per_m"] = stability.brake_n_s_per_m
    bench.memory.receiver["settings"]["coupling_n_per_m"] = stability.coupling_n_per_m


WAYS = {
    "auto": auto,
    "nothing": plain(),
    "damping 2": plain(damping_n_s_per_m=2.0),
    "coupling 1000": plain(coupling_n_per_m=1000.0),
    "passivity, delay told": passivity_only,
    "auto, passivity": partial(auto, spec=RenderSpec(passivity=True)),
}


def measure(every: int) -> Figures:
    """Measure all ways to render."""
    return {"rows": {name: run(render, every) for name, render in WAYS.items()}}


def bars(figures: Figures) -> list[Bar]:
    """Require stability and the wall's stiffness with the player's settings."""
    row = figures["rows"]["auto"]
    return [
        at_most("limit cycles above 20 mN, cases", row["cycles"], 0),
        at_most("force about its mean at rest, worst", row["worst_rms_n"], CYCLE_N, "N"),
        at_most("energy while held, or in the whole touch, cases", row["drives"] + row["gives"], 0),
        at_most("more than 10 % off where Colgate allows the wall, cases", row["soft"], 0),
        at_least("stiffness felt over the wall's, least", row["least_felt"], 1 - STIFFNESS_TOLERANCE),
    ]


if __name__ == "__main__":
    bench("stability", __doc__, measure, bars, every=(1, 20))
