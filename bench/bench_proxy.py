"""Compares rendering by a proxy, a point that stays on the surface, with the plain field: contact, accuracy,
energy, vibration.

    python bench/bench_proxy.py [--quick] [--seconds S] [--walks N] [--lattices N] [--points N]

A simulated hand of 0.1 kg is rendered with the proxy and with the plain field:

* holds: the hand is pushed with 3 N into plates of 1, 2 and 5 mm, near their edge, into an inner corner, onto
  an outer edge and, guided by a spring of 500 N/m, into the desk of TUM fr1_rpy. A press holds if the hand
  comes to rest with the proxy on the side that it came from.
* plates: the same push into plates of 1, 2 and 5 mm, thin along x, y and z and tilted by 30 degrees, on
  lattices of 2^6 to 2^8 samples (`--lattices` of them), as the encoder thickens them: free onto both faces,
  where the hand has to rest, and guided onto faces, edges and corners from 26 directions, where it may slip
  round the rim but not pass through.
* truth: errors of force and friction where the exact force is known.
* energy: the largest net energy that the hand receives in `--seconds` (60) of random pressing.
* speed: time of a proxy query while a hand slides over the surface.
* hum: vibration from 40 to 400 Hz while a hand slides at 50 mm/s.
* friction: drag over normal force, vibration at rest and energy, also on curved surfaces (``friction.py``).
* seams: the largest step of the force at the end of a loop, at seeks and at the start of a segment, beside
  the field's own (``seams.py``), for hands that rest at `--points` points.
* rests: the same of as many hands that rest on depth sequences, bodies that fall, a terrain, a live stream
  and a deformed medium while these change (``rests.py``).
* swings: hands on springs that swing by themselves beside the edges of heaps of boxes (``swings.py``).

`--walks` is the number of paths over the surface in the tests of speed and hum.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import friction
import rests
import seams
import swings
from machine import SHARED, Bar, Figures, at_most, bench
from touchfield.compute.native import native
from touchfield.medium import ForceField
from touchfield.perception.hand_motion import in_band, points_on_surface, slide_m, surface_walks
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.spec import wall_of
from touchfield.sources.shapes.shapes import Box, Sphere

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "render"))
from proxy_makers import Held, field_of, ramp_n

DESK = SHARED / "rgbd_tum_fr1_rpy"
BALL, BLOCK = Sphere((0.0, 0.0, 0.0), 0.025), Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.015))
PUSH_N, DESK_POINTS = 3.0, 24


def plate(thickness_m: float) -> ForceField:
    """Return a plate of 60 x 40 mm."""
    field: ForceField = field_of(Box((0.0, 0.0, 0.0), (0.03, 0.02, thickness_m / 2)))
    return field


def comes_to_rest(field: ForceField, start: Any, push: Any, is_proxy: bool) -> bool:
    """Return whether a pushed hand comes to rest and the proxy stays out of the field."""
    rig = Held(field, is_proxy=is_proxy)
    hand, forces, proxy = rig.pushed(start, push, 1.5)
    rests = float(np.linalg.norm(hand[-1] - hand[-100])) < 2e-4 and float(np.linalg.norm(forces[-1])) > 1.0
    outside = (
        not is_proxy or float(np.linalg.norm(field.sample_n(proxy), axis=1).max()) < 6 * rig.wall.level_n
    )
    return rests and outside


def holds() -> Figures:
    """Count the presses of each kind that hold."""
    cases: dict[str, list[tuple[ForceField, Any, Any]]] = {}
    for mm in (1, 2, 5):
        field = plate(1e-3 * mm)
        cases[f"plate {mm} mm"] = [
            (field, (x, y, 0.006), ramp_n((0, 0, -1), PUSH_N))
            for x in (-0.01, 0.004)
            for y in (-0.008, 0.003)
        ]
        cases[f"plate {mm} mm, 4 mm from its edge"] = [
            (field, (0.026, 0.0, 0.006), ramp_n((0, 0, -1), PUSH_N))
        ]
    corner = field_of(Box((0, 0, 0), (0.03, 0.02, 0.004)), Box((0.02, 0, 0.012), (0.004, 0.02, 0.016)))
    cases["inner corner"] = [(corner, (0.005, y, 0.0), ramp_n((1, 0, -1), PUSH_N)) for y in (0.0, 0.01)]
    edge = field_of(BLOCK)
    cases["outer edge"] = [
        (edge, (0.036, y, 0.021), ramp_n((-1, 0, -1), PUSH_N, 0.3, 500.0)) for y in (0, 0.01)
    ]
    if DESK.is_dir():
        desk = prepare(str(DESK), EncodeSpec(frames=(0, 10))).medium[0]
        presses: list[tuple[ForceField, Any, Any]] = []
        for point in points_on_surface(desk, DESK_POINTS, np.random.default_rng(0)):
            normal = desk.sample_n(point[None])[0]
            normal /= np.linalg.norm(normal)
            free = [x for x in (0.004, 0.006, 0.01) if not desk.sample_n((point + x * normal)[None]).any()]
            if free:
                presses.append((desk, point + free[0] * normal, ramp_n(-normal, PUSH_N, 0.3, 500.0)))
        cases["TUM desk"] = presses
    rows = {}
    for name, some in cases.items():
        counts = [
            sum(comes_to_rest(f, start, push, mode) for f, start, push in some) for mode in (True, False)
        ]
        rows[name] = {"presses": len(some), "proxy": counts[0], "field": counts[1]}
    return rows


def passes_through(box: Box, field: ForceField, start: Any, push: Any) -> bool:
    """Return whether a pushed hand passes through a plate, and not around its rim.

    The proxy, which is at the hand where nothing stops it, then crosses the middle plane of the plate farther
    than two samples within its outline: nearer to an edge the low-pass has rounded the plate.
    """
    _, _, proxy = Held(field).pushed(start, push, 1.5)
    half = np.asarray(box.half_extents_m)
    local, thin = proxy @ box.axes, int(half.argmin())
    crosses = np.flatnonzero(np.sign(local[1:, thin]) != np.sign(local[:-1, thin]))
    inner = np.delete(half, thin) - 2 * max(field.grid.spacing_m)
    is_inside = (np.abs(np.delete((local[crosses] + local[crosses + 1]) / 2, thin, axis=1)) < inner).all(
        axis=1
    )
    return bool(is_inside.any())


def press_plate(box: Box, nw: int) -> Figures:
    """Count free presses onto both faces of a plate that come to rest, and guided ones that do not pass.

    The latter go towards its faces, edges and corners from 26 directions.
    """
    field: ForceField = field_of(box, nw=nw)
    axes, half = box.axes, np.asarray(box.half_extents_m)
    thin, rests, stopped = int(half.argmin()), 0, 0
    for sign in (1, -1):
        normal = sign * axes[:, thin]
        for a, b in ((0.004, -0.003), (-0.009, 0.006)):
            start = axes @ np.insert([a, b], thin, 0.0) + 0.008 * normal
            rests += comes_to_rest(field, start, ramp_n((-normal).tolist(), PUSH_N), is_proxy=True)
    sides = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    for signs in sides[sides.any(axis=1)]:
        unit = axes @ signs / np.linalg.norm(signs)
        push = ramp_n((-unit).tolist(), PUSH_N, 0.3, 500.0)
        stopped += not passes_through(box, field, axes @ (signs * half) + 0.008 * unit, push)
    return {"presses": 4 + 26, "proxy": rests + stopped, "on_faces": rests, "from_26_sides": stopped}


def plates(lattices: int) -> Figures:
    """Count the presses into thin plates that hold, by thickness, direction and lattice."""
    rows = {}
    for nw in range(6, 6 + lattices):
        for mm in (1, 2, 5):
            for name, axis, tilt in (("x", 0, 0.0), ("y", 1, 0.0), ("z", 2, 0.0), ("tilted", 1, 30.0)):
                half = [0.03, 0.03, 0.03]
                half[axis] = 5e-4 * mm
                box = Box((0.0, 0.0, 0.0), (half[0], half[1], half[2]), (tilt, 0.0, 0.0))
                rows[f"{mm} mm, {name}, nw {nw}"] = press_plate(box, nw)
    return rows


def truth() -> Figures:
    """Return relative errors of forces of 1 to 3 N, and of friction.

    The friction coefficient mu is from 0.2 to 0.8.
    """
    rng, errors, slips = np.random.default_rng(1), [], []
    ball, block = Held(field_of(BALL)), Held(field_of(BLOCK))
    for depth in np.linspace(0.002, 0.006, 9):
        for _ in range(30):
            unit = rng.normal(size=3)
            unit /= np.linalg.norm(unit)
            x, y = rng.uniform(-0.6, 0.6, 2) * (0.02, 0.01)
            for rig, start, end in (
                (ball, 0.03 * unit, (0.025 - depth) * unit),
                (block, np.array([x, y, 0.02]), np.array([x, y, 0.015 - depth])),
            ):
                rig.memory.receiver["state"]["proxy"]["is_active"] = 0.0
                for fraction in np.linspace(0, 1, 40):
                    force = rig.tick(start + fraction * (end - start))
                errors.append(abs(np.linalg.norm(force) / (500 * depth) - 1))
    for mu in (0.2, 0.5, 0.8):
        rig = Held(field_of(BLOCK), mu=mu)
        stick_n_per_m = rig.value("settings.stick_n_per_m")
        damper_n_s_per_m = rig.value("settings.stick_n_s_per_m")
        for z in np.linspace(0.02, 0.013, 40):
            rig.tick(np.array([0.0, 0.0, z]))
        for way in np.linspace(0, 0.005, 300):
            rig.tick(np.array([way, 0.3 * way, 0.013]))
            max_friction_n = mu * np.linalg.norm(rig.value("state.field_force_n"))
            pull_n = stick_n_per_m * np.hypot(way, 0.3 * way)
            pull_n += damper_n_s_per_m * np.linalg.norm(rig.value("state.velocity_m_s")[:2])
            expected_n = min(pull_n, max_friction_n)
            slips.append(abs(np.linalg.norm(rig.value("state.friction_n")) - expected_n) / max_friction_n)
    return {
        "error": float(np.mean(errors)),
        "worst_error": float(np.max(errors)),
        "slip": float(np.max(slips)),
    }


def energies(damping: float, seconds: int) -> Figures:
    """Return the largest and the final net energy of random pressing, joules."""
    rows = {}
    for name, shape, surface_m in (("ball", BALL, 0.025), ("block", BLOCK, 0.015)):
        rng, rig = np.random.default_rng(2), Held(field_of(shape), damping=damping)
        x, v, work_j, max_work_j = np.array([0.0, 0.0, 0.035]), np.zeros(3), 0.0, 0.0
        way, goal = rng.normal(size=3), np.zeros(3)
        for n in range(1000 * seconds):
            if n % 250 == 0:
                way = 0.7 * way + rng.normal(size=3) + [0, 0, 1.0]
                goal = (surface_m - rng.uniform(-0.004, 0.006)) * way / np.linalg.norm(way)
            force, before = rig.tick(x), x
            for _ in range(4):
                v = v + (500 * (goal - x) - 14 * v + force) / 0.1 * 2.5e-4
                x = x + v * 2.5e-4
            work_j += float(force @ (x - before))
            max_work_j = max(max_work_j, work_j)
        rows[name] = {"most_j": max_work_j, "in_the_end_j": work_j}
    return rows


def _query(memory: Any, frame: int, x: float, y: float, z: float) -> None:
    native.contact_force(memory, frame, frame, 0.0, x, y, z)


def _nothing(memory: Any, frame: int, x: float, y: float, z: float) -> None:
    """A call of a function without work: a vibration of a medium that has none."""
    native.vibration_at(memory, frame, frame, 0.0, x, y, z)


def speeds(fields: dict[str, ForceField], count: int) -> Figures:
    """Time a query while a hand slides 2 mm deep, edges included, microseconds."""
    rows = {}
    for name, field in fields.items():
        rig, rng = Held(field), np.random.default_rng(3)
        walks = surface_walks(field, 0.03, count, rng)
        points = np.concatenate(
            [ways.swapaxes(0, 1).reshape(-1, 3) for ways in slide_m(walks, 0.1, 0.3, 1000.0)]
        )
        took = []
        for call in (_query, _nothing):
            call(rig.memory.bytes, rig.frames[0], *points[0])
            times = np.empty((5, len(points)))
            for run in times:
                for n, point in enumerate(points.tolist()):
                    began = time.perf_counter()
                    call(rig.memory.bytes, rig.frames[0], *point)
                    run[n] = time.perf_counter() - began
            took.append(
                1e6 * np.percentile(times.min(axis=0), [50, 99, 99.9])
            )  # the minimum excludes interruptions
        quick = took[0] - np.median(took[1])
        rows[name] = dict(zip(("p50_us", "p99_us", "p99_9_us"), quick.tolist(), strict=True))
    return rows


def hums(fields: dict[str, ForceField], count: int) -> Figures:
    """Return the vibration of slides from 40 to 400 Hz, mN rms.

    With the proxy and of the plain field. The hand hangs on a spring of 500 N/m, whose far end moves along
    the surface 2 mm below the level of 1 N.
    """
    rows = {}
    for name, field in fields.items():
        walks = surface_walks(field, 0.05, count, np.random.default_rng(4))
        row: Figures = {}
        for key, is_proxy in (("proxy", True), ("field", False)):
            powers = []
            ways = (way for some in slide_m(walks, 0.05, 1.0, 1000.0) for way in some.swapaxes(0, 1))
            for way in (way for way in ways if len(way) >= 900):
                normals = field.sample_n(way).astype(np.float64)
                goal = way - 0.002 * normals / np.linalg.norm(normals, axis=1, keepdims=True)
                rig = Held(field, is_proxy=is_proxy, damping=0.3)
                spring = lambda t, x, goal=goal: 500.0 * (goal[round(1000 * t)] - x)  # noqa: E731
                start = way[0] + 0.004 * normals[0] / np.linalg.norm(normals[0])
                _, forces, _ = rig.pushed(start, spring, 1e-3 * len(way), damping=14.0)
                powers.append((in_band(forces[100:], 1000.0) ** 2).sum(axis=1).mean())
            row[key] = 1e3 * float(np.sqrt(np.median(powers))) if powers else float("nan")
        rows[name] = row
    return rows


def stiffness_of(field: ForceField) -> float:
    """Return the stiffness of a field's wall, N/m."""
    wall = wall_of(field)
    assert wall is not None
    return float(wall.stiffness_n_per_m)


MAX_SEAM_POINTS = 24
"""Hands of `seams`, each of which goes through a session of its own."""


def measure(seconds: int, walks: int, lattices: int, points: int) -> Figures:
    """Measure all figures on the available fields."""
    fields: dict[str, ForceField] = {
        "ball": field_of(BALL),
        "block": field_of(BLOCK),
        "plate 2 mm": plate(0.002),
    }
    fields["terrain"] = prepare("sample:terrain", EncodeSpec()).medium[0]
    if DESK.is_dir():
        fields["TUM desk"] = prepare(str(DESK), EncodeSpec(frames=(0, 10))).medium[0]
    return {
        "stiffness_n_per_m": {name: stiffness_of(field) for name, field in fields.items()},
        "holds": holds(),
        "plates": plates(lattices),
        "truth": truth(),
        "energy": energies(0.3, seconds),
        "speed": speeds(fields, walks),
        "hum_mn": hums(fields, walks),
        "friction": friction.friction(lattices),
        "seams_mn": seams.seams(min(points, MAX_SEAM_POINTS)),
        "rests_mn": rests.rests(points, min(lattices, 2)),
        "swings": swings.swings(points),
    }


def bars(figures: Figures) -> list[Bar]:
    """Require that all presses hold, accurate forces, no energy, and fast queries."""
    rows = figures["holds"] | figures["plates"]
    missed = {name: row["presses"] - row["proxy"] for name, row in rows.items()}
    return [
        *(
            at_most(f"{name}: presses that the proxy does not hold", count, 0)
            for name, count in missed.items()
        ),
        at_most("mean error of the force beside the closed form", figures["truth"]["error"], 0.01),
        at_most("error of friction, shares of mu N", figures["truth"]["slip"], 0.02),
        *(
            at_most(f"{name}: most energy given", row["most_j"], 1e-3, "J")
            for name, row in figures["energy"].items()
        ),
        *(
            at_most(f"{name}: a query, p99.9", row["p99_9_us"], 5.0, "us")
            for name, row in figures["speed"].items()
        ),
        *friction.bars(figures["friction"]),
        *seams.bars(figures["seams_mn"]),
        *rests.bars(figures["rests_mn"]),
        *swings.bars(figures["swings"]),
    ]


if __name__ == "__main__":
    bench("proxy", __doc__, measure, bars, seconds=(60, 5), walks=(8, 4), lattices=(3, 1), points=(200, 3))
