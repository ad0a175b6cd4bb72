"""Friction on flat and curved surfaces: drag over normal force while sliding, vibration at rest, and energy.

A block, a ball and the terrain (`sample:terrain`) are rendered to a point by the proxy ("auto") and by the
field, and to a ball of 5 mm as the tool, on lattices of 2^6 to 2^8 samples. Hands, scripted or on a spring
(0.2 kg, 200 N/m, 2 N s/m), are pressed 0.5 to 8 mm deep and slide along the surface at 5 to 200 mm/s, with mu
from 0.1 to 1. The normal force is |F|, and friction lies along it.

* over: the largest |friction| / (mu |F|) - 1 of all ticks.
* off: the largest deviation of |friction| from mu |F| while a hand slides, over mu |F|: after the
  hand has pulled the anchor without a turn by twice what stretches its spring to the cone.
* felt_off: of scripted hands on the block and the ball, the mean of the whole force against the motion over
  the mean along the exact normal, beside mu, over mu: it has the errors of the field's normals, too.
* given_mj: the most energy that friction has given to a hand at any time, mJ, less what a spring that is
  constant within each tick gives, k dx^2 / 2.
* rest_band_mn: vibration from 40 to 400 Hz on hands of 0.05 to 0.2 kg that were pulled 3 mm along the surface
  and came to rest, mu 0.1 to 0.4, mN rms.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from hands import Hands, Runs, Spring
from machine import Bar, Figures, at_most
from touchfield.devices import device
from touchfield.medium import ForceField, HapticMedium
from touchfield.perception.hand_motion import in_band, surface_walks
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.spec import RenderSpec
from touchfield.render.tool import Tool
from touchfield.sources.shapes.shapes import Box, Sphere

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "render"))
from proxy_makers import field_of

SURFACES, KINDS = ("block", "ball", "terrain"), ("auto", "field", "tool")
MUS, DEPTHS_M, SPEEDS_M_S = (0.1, 0.3, 1.0), (0.0005, 0.002, 0.008), (0.005, 0.05, 0.2)
WALKS, REST_MUS, REST_KG = 4, (0.1, 0.4), (0.05, 0.2)
BALL_M, TOP_M, TOOL_M = 0.025, 0.015, 0.005
TOOL = Tool.sphere(TOOL_M, 100)
STRONG = replace(device("phantom-omni"), force_max_n=30.0, force_continuous_n=None, torque_max_nm=5.0)
OUTSIDE_M, PRESS, HOLD, REST_TICKS = 0.002, 150, 50, 5000
"""Where a hand starts, and ticks of pressing and waiting."""
MARGIN_M, LEAST_M, LEAST_N = 0.0005, 0.016, 0.02
"""Beyond the stretched spring of the anchor; the shortest way; the least normal force that counts."""
MAX_OVER, MAX_OFF, MAX_BAND_MN, MAX_GIVEN_MJ = 1e-6, 0.02, 0.002, 1e-3


class Way(NamedTuple):
    """Points of a surface and its outward normals there, float64 [n, 3] each, a tick apart."""

    points_m: Any
    normals: Any


# -- surfaces ----------------------------------------------------------------------------------------------


@cache
def surface(name: str, nw: int) -> ForceField:
    """Return the field of a surface."""
    if name == "terrain":
        return prepare("sample:terrain", EncodeSpec(nw=nw)).medium[0]
    shape = Box((0.0, 0.0, 0.0), (0.03, 0.02, TOP_M)) if name == "block" else Sphere((0.0, 0.0, 0.0), BALL_M)
    field: ForceField = field_of(shape, nw=nw)
    return field


@cache
def terrain_ways(nw: int, length_m: float) -> Any:
    """Return ways over the terrain as functions of the length along them, metres."""
    walks = surface_walks(surface("terrain", nw), length_m, 12, np.random.default_rng(6))
    whole = np.flatnonzero(walks.steps == len(walks.points_m))[:WALKS]
    return CubicSpline(walks.step_m * np.arange(len(walks.points_m)), walks.points_m[:, whole])


def ways(name: str, nw: int, speed_m_s: float, length_m: float) -> list[Way]:
    """Return ways along a surface at a speed."""
    along_m = np.arange(0.0, length_m, speed_m_s * 1e-3)
    if name == "block":
        units = np.array([(0.8, -0.6, 0.0), (0.6, 0.8, 0.0)])
        up = np.array([0.0, 0.0, 1.0])
        return [
            Way((along_m - length_m / 2)[:, None] * unit + TOP_M * up, np.tile(up, (len(along_m), 1)))
            for unit in units
        ]
    if name == "ball":
        angles = along_m / BALL_M
        circles = [((1.0, 0.0, 0.0), (0.0, 0.6, 0.8)), ((0.6, 0.0, 0.8), (-0.48, 0.8, 0.36))]
        arcs = [np.outer(np.cos(angles), a) + np.outer(np.sin(angles), b) for a, b in circles]
        return [Way(BALL_M * arc, arc) for arc in arcs]
    found = []
    for points_m in terrain_ways(nw, length_m)(along_m).swapaxes(0, 1):
        normals = surface(name, nw).sample_n(points_m).astype(np.float64)
        found.append(Way(points_m, normals / np.linalg.norm(normals, axis=1, keepdims=True)))
    return found


def pressed(way: Way, kind: str, depth_m: float) -> Any:
    """Return positions of a hand that is pressed into a surface and then moves along it, float64 [n, 3]."""
    out_m = TOOL_M if kind == "tool" else 0.0
    heights_m = np.r_[np.linspace(OUTSIDE_M, -depth_m, PRESS), np.full(HOLD, -depth_m)] + out_m
    down = way.points_m[0] + heights_m[:, None] * way.normals[0]
    return np.concatenate([down, way.points_m + (out_m - depth_m) * way.normals])


@lru_cache(maxsize=3)
def _crowd(name: str, nw: int, kind: str) -> Hands:
    spec = RenderSpec(
        friction=MUS[0], up="lattice", render="auto" if kind == "auto" else "field",
        tool=TOOL if kind == "tool" else None,
    )  # fmt: skip
    medium = HapticMedium.from_frames([surface(name, nw)], 30.0)
    return Hands(medium, device=STRONG, spec=spec, has_proxy=kind == "auto")


def crowd(name: str, nw: int, kind: str, mu: float) -> Hands:
    """Return hands that have not started, on a surface of a friction."""
    hands = _crowd(name, nw, kind)
    hands.restart()
    receiver = hands.memory.receiver
    receiver["settings"]["friction"] = receiver["state"]["friction"] = mu
    return hands


# -- figures -----------------------------------------------------------------------------------------------


class Slide(NamedTuple):
    """What one hand felt that slid: worst ratios, energy, and how many ticks it slid."""

    over: float
    off: float
    given_j: float
    ticks: int
    felt_off: float


def slide_of(runs: Runs, hand: int, mu: float, k: float, way: Way) -> Slide:
    """Return the figures of one hand on a way; `k` is the spring of the anchor, N/m."""
    position_m, field_n, friction_n = (column[hand] for column in runs[:3])
    normal_n, drag_n = np.linalg.norm(field_n, axis=1), np.linalg.norm(friction_n, axis=1)
    ratio = drag_n / np.maximum(mu * normal_n, 1e-12)
    ratio[normal_n <= 0] = 0.0
    moved_m = np.diff(position_m, axis=0, prepend=position_m[:1])
    work_j = np.cumsum(np.r_[0.0, (friction_n[:-1] * moved_m[1:]).sum(axis=1)])
    allowed_j = np.cumsum(0.5 * k * (moved_m**2).sum(axis=1))
    least_m = 2 * mu * np.maximum.accumulate(normal_n) / k + MARGIN_M
    is_sliding = pulled_m(moved_m, field_n, friction_n, k / mu) > least_m
    is_sliding &= normal_n > LEAST_N
    is_sliding[: PRESS + HOLD] = False
    off = np.where(is_sliding, np.abs(ratio - 1), 0.0)
    given_j = float((work_j - allowed_j).max())
    return Slide(
        float(ratio.max() - 1),
        float(off.max()),
        given_j,
        int(is_sliding.sum()),
        felt_off(runs, hand, mu, is_sliding, way),
    )


def pulled_m(moved_m: Any, field_n: Any, friction_n: Any, max_n_per_m: float) -> Any:
    """Return how far the point that friction acts on has pulled the anchor without a turn, metres [n].

    The way counts along the friction. It begins anew where friction does not oppose the motion within 60
    degrees, the motion turns by more, or the normal force grows by more than `max_n_per_m` of the pull: then
    the point sticks.
    """
    normal_n = np.linalg.norm(field_n, axis=1)
    normals = field_n / np.maximum(normal_n, 1e-12)[:, None]
    moved_m = moved_m - (moved_m * normals).sum(axis=1, keepdims=True) * normals
    sizes_m, drag_n = np.linalg.norm(moved_m, axis=1), np.linalg.norm(friction_n, axis=1)
    against_m = -(friction_n * moved_m).sum(axis=1) / np.maximum(drag_n, 1e-12)
    turns = np.r_[1.0, (moved_m[1:] * moved_m[:-1]).sum(axis=1)] < 0.5 * sizes_m * np.r_[1.0, sizes_m[:-1]]
    is_pulling = (against_m > 0.5 * sizes_m) & ~turns & (sizes_m > 1e-7)
    is_pulling &= np.diff(normal_n, prepend=normal_n[:1]) <= max_n_per_m * against_m
    ways_m = np.zeros(len(sizes_m))
    for n in range(1, len(ways_m)):
        ways_m[n] = (ways_m[n - 1] + against_m[n]) * is_pulling[n]
    return ways_m


def felt_off(runs: Runs, hand: int, mu: float, is_sliding: Any, way: Way) -> float:
    """Return by how much drag over normal force is off mu, over mu, with the normals of the way itself."""
    at = np.flatnonzero(is_sliding)
    if not len(at):
        return 0.0
    force_n = runs.field_n[hand, at] + runs.friction_n[hand, at]
    tangents = np.gradient(way.points_m, axis=0)[at - PRESS - HOLD]
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    drag_n = -(force_n * tangents).sum(axis=1).mean()
    return float(abs(drag_n / (force_n * way.normals[at - PRESS - HOLD]).sum(axis=1).mean() / mu - 1))


def slides(name: str, nw: int, kind: str, is_spring: bool) -> Iterator[tuple[str, Slide]]:
    """Yield the slides on one surface, each with what it was."""
    for mu, speed_m_s in itertools.product(MUS, SPEEDS_M_S):
        length_m = LEAST_M if speed_m_s < 0.01 else 0.024
        some = ways(name, nw, speed_m_s, length_m)
        kinds = list(itertools.product(DEPTHS_M, some))
        paths = [pressed(way, kind, depth_m) for depth_m, way in kinds]
        ticks = min(map(len, paths), default=0)
        if not ticks:
            continue
        hands = crowd(name, nw, kind, mu)
        k = float(hands.memory.receiver["settings"]["stick_n_per_m"])
        runs = hands.run(np.array([path[:ticks] for path in paths]), ticks, Spring() if is_spring else None)
        for hand, (depth_m, way) in enumerate(kinds):
            what = (
                f"nw {nw}, mu {mu:g}, {1e3 * depth_m:g} mm, {1e3 * speed_m_s:g} mm/s, way {hand % len(some)}"
            )
            yield what, slide_of(runs, hand, mu, k, way)


def rest_band_mn(name: str, nw: int, kind: str) -> float:
    """Return the vibration of hands on springs that were pulled along the surface, mN rms."""
    worst = 0.0
    for mu, kg in itertools.product(REST_MUS, REST_KG):
        some = ways(name, nw, 0.015, 0.003)
        paths = [pressed(way, kind, 0.012) for way in some]
        ends = [np.concatenate([path, np.tile(path[-1], (REST_TICKS - len(path), 1))]) for path in paths]
        if ends:
            forces = crowd(name, nw, kind, mu).run(np.array(ends), REST_TICKS, Spring(kg=kg)).force_n
            bands = [in_band(force[-1500:], 1000.0) for force in forces]
            worst = max(worst, *(1e3 * float(np.sqrt((band**2).sum(axis=1).mean())) for band in bands))
    return worst


def friction(lattices: int) -> Figures:
    """Measure friction on all surfaces, on `lattices` lattices from nw 6."""
    rows: Figures = {}
    for name, kind, is_spring in itertools.product(SURFACES, KINDS, (False, True)):
        found = [row for nw in range(6, 6 + lattices) for row in slides(name, nw, kind, is_spring)]
        worst_over, worst_off = (max(found, key=key) for key in (lambda r: r[1].over, lambda r: r[1].off))
        row: Figures = {
            "slides": sum(one.ticks > 0 for _, one in found),
            "over": worst_over[1].over,
            "off": worst_off[1].off,
            "off_at": worst_off[0],
            "given_mj": 1e3 * max(one.given_j for _, one in found),
        }
        if not is_spring and name != "terrain":
            row["felt_off"] = max(one.felt_off for _, one in found)
        if is_spring:
            row["rest_band_mn"] = max(rest_band_mn(name, nw, kind) for nw in range(6, 6 + lattices))
        rows[f"{name}, {kind}, {'spring' if is_spring else 'scripted'}"] = row
    return rows


def bars(rows: Figures) -> list[Bar]:
    """Require Coulomb friction, silence at rest, and energy that only leaves."""
    found = []
    for name, row in rows.items():
        found += [
            at_most(f"{name}: friction over mu |F|, beyond 1", row["over"], MAX_OVER),
            at_most(f"{name}: friction off mu |F| while sliding", row["off"], MAX_OFF),
            at_most(f"{name}: energy that friction gives", row["given_mj"], MAX_GIVEN_MJ, "mJ"),
        ]
        if "rest_band_mn" in row:
            found.append(at_most(f"{name}: 40 to 400 Hz at rest", row["rest_band_mn"], MAX_BAND_MN, "mN"))
    return found
