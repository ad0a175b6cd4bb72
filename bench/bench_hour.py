"""Lets hands that know nothing of the renderer wander over media for an hour, and counts what they should not
feel: clicks, chatter at rest, and walls that give way.

    python bench/bench_hour.py [--quick] [--minutes M]

Twenty seeded hands (0.2 kg on a spring of 200 N/m with 2 N s/m, whose end moves as a person's intent does)
share `--minutes` of medium time. They travel, press with 0.5 to 3 N, tap, rest, and slide at 5 to 200 mm/s,
towards random points of the surface as it is at that time. The media are a terrain and a ball with mu 0.3, a
plate of 2 mm, TUM fr1_rpy (24 frames, looped), and bodies that fall (`sample:falling-7`, looped). Each is
rendered by the proxy ("auto"), and the same intents by the field. Along the path of the proxy's hand, the
field is read too ("beside").

* clicks: steps of the force from one tick of 1 ms to the next of more than twice what explains them: the
  largest step beside within 5 ms, or K v dt + c dv, whichever is more, and c v where contact begins or ends.
  K is the stiffness of the wall and of friction, v the speed of the hand beside the fastest body, and c 2 N
  s/m. 30 mN are always allowed, and a raised cosine from the full force within 0.1 s of the end of a loop.
  Steps within 50 ms are one click.
* jumps: steps beyond twice K v dt + c dv alone, also of the field.
* chatter: quarters of a second of rest, a second after the hand has come, with more than 2 mN rms from 40 to
  400 Hz, and more than twice as much as beside.
* gave_way: presses at whose end the hand is farther behind the surface than the wall explains (1.5 F / K + 1
  mm), and feels less than 0.3 of the force that it presses with. On a medium that changes, the surface may
  have gone: only the difference from the field tells anything.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import rests
from hands import Hands, Runs, Spring
from machine import SHARED, Bar, Figures, at_most, bench
from touchfield.medium import ForceField, HapticMedium
from touchfield.perception.hand_motion import in_band, surface_walks
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.spec import RenderSpec, wall_of
from touchfield.sources.shapes.shapes import Box, Sphere

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "render"))
from proxy_makers import field_of

HANDS, PART_TICKS, BAND_TICKS, SEED = 20, 20_000, 250, 47
WALK_M, WALKS, OUTSIDE_M, STICK_N_PER_M = 0.06, 40, 0.012, 1000.0
DAMPER_N_S_PER_M, ALLOWED_N, RATIO, NEAR, FADE, APART = 2.0, 0.030, 2.0, 5, 105, 50
CHATTER_N, EDGE_N, LARGEST_N, FADE_STEP = 2e-3, 0.1, 3.3, 0.0173
"""Least vibration that counts; a force at the edge of contact; the limit of the force; and the steepest tick
of a fade, a fraction of it.
"""
SPRING = Spring()


@dataclass(frozen=True)
class World:
    """A medium to wander over.

    ``surface(tick)`` is its field then, from which hands choose where to go; `centre_m` is what they go round
    on their way, if there is something to go round. `period` is that of a loop, ticks, not always whole;
    `speeds_m_s` are those of the fastest body, float64 [period]. Touches are within `reach_m` of the middle:
    hands slip off a rim.
    """

    medium: Any
    surface: Callable[[int], ForceField]
    friction: float = 0.0
    centre_m: Any = None
    period: float = 0.0
    every: int = 10**9
    speeds_m_s: Any = None
    reach_m: tuple[float, float, float] = (1.0, 1.0, 1.0)
    is_static: bool = True


class Press(NamedTuple):
    """A press of a plan: when the end of the spring is at rest behind the surface, and where that is."""

    hand: int
    start: int
    stop: int
    point_m: Any
    normal: Any
    push_n: float


# -- intents -----------------------------------------------------------------------------------------------


def smooth(start_m: Any, end_m: Any, ticks: int) -> Any:
    """Return positions of a motion of least jerk, float64 [ticks, 3]."""
    u = (np.arange(1, ticks + 1) / ticks)[:, None]
    return start_m + (end_m - start_m) * (u**3 * (10 - 15 * u + 6 * u**2))


class Intents:
    """Plans where the ends of the springs of all hands go, part after part."""

    def __init__(self, world: World, seed: int) -> None:
        self._world, self._rng = world, np.random.default_rng(seed)
        self._walks: dict[int, list[Any]] = {}
        self._at = [self._start() for _ in range(HANDS)]

    def _start(self) -> Any:
        points, normals = self._way(0)
        return points[0] + OUTSIDE_M * normals[0]

    def _way(self, tick: int) -> tuple[Any, Any]:
        """Return points and normals of a way over the surface at a tick, float64 [n, 3] each."""
        period, every = self._world.period, self._world.every
        key = int(tick % period if period else 0) // every
        if key not in self._walks:
            field = self._world.surface(key * every)
            walks = surface_walks(field, WALK_M, WALKS, self._rng)
            walked = [walks.points_m[:steps, n] for n, steps in enumerate(walks.steps) if steps > 1]
            ended = [self._ended(field, way) for way in walked]
            self._walks[key] = [way for way in ended if len(way[0]) > 1]
        ways = self._walks[key]
        points, normals = ways[self._rng.integers(len(ways))]
        return points, normals

    def _ended(self, field: ForceField, way: Any) -> tuple[Any, Any]:
        """Return the part of a way that is within reach, and its normals."""
        is_off = (np.abs(way) > self._world.reach_m).any(axis=1)
        way = way[: int(is_off.argmax())] if is_off.any() else way
        normals = field.sample_n(way).astype(np.float64).reshape(-1, 3)
        return way, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)

    def part(self, tick: int, stiffness_n_per_m: float) -> tuple[Any, list[Press]]:
        """Return the goals of a part, float64 [hands, ticks, 3], and its presses and rests."""
        goals, presses = np.empty((HANDS, PART_TICKS, 3)), list[Press]()
        for hand in range(HANDS):
            n = 0
            while n < PART_TICKS:
                moves, some = self._episode(hand, tick + n, stiffness_n_per_m)
                if n + len(moves) > PART_TICKS:
                    goals[hand, n:] = self._at[hand]
                    break
                goals[hand, n : n + len(moves)] = moves
                self._at[hand] = moves[-1]
                presses += [one._replace(start=one.start + n, stop=one.stop + n) for one in some]
                n += len(moves)
        return goals, presses

    def _episode(self, hand: int, tick: int, stiffness: float) -> tuple[Any, list[Press]]:
        """Return one travel and one touch."""
        rng = self._rng
        points, normals = self._way(tick)
        outside = points[0] + OUTSIDE_M * normals[0]
        moves = [self._travel(self._at[hand], outside)]
        moves.append(np.tile(outside, (150, 1)))
        kind = rng.choice(["press", "tap", "rest", "slide"])
        push_n = rng.uniform(0.5, 3.0)
        inside = points - push_n * (1 / SPRING.n_per_m + 1 / stiffness) * normals
        before, presses = sum(map(len, moves)), list[Press]()
        if kind == "tap":
            for _ in range(rng.integers(2, 6)):
                moves += [smooth(outside, inside[0], 90), smooth(inside[0], outside, 110)]
            return np.concatenate(moves), presses
        approach = int(rng.uniform(300, 700))
        hold = int(rng.uniform(3000, 6000) if kind == "rest" else rng.uniform(500, 2000))
        moves += [smooth(outside, inside[0], approach), np.tile(inside[0], (hold, 1))]
        presses.append(
            Press(hand, before + approach, before + approach + hold, points[0], normals[0], push_n)
        )
        last = 0
        if kind == "slide":
            last = len(points) - 1
            along = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
            speed = float(np.exp(rng.uniform(np.log(0.005), np.log(0.2))))
            at = np.arange(0.0, min(along[-1], 3.0 * speed), speed * 1e-3)
            last = min(last, int(np.searchsorted(along, at[-1])))
            moves.append(np.stack([np.interp(at, along, column) for column in inside.T], axis=1))
        away = points[last] + OUTSIDE_M * normals[last]
        moves.append(smooth(moves[-1][-1], away, 300))
        return np.concatenate(moves), presses

    def _travel(self, start: Any, end: Any) -> Any:
        """Return a way to the next touch: straight, or round what is in the middle."""
        centre = self._world.centre_m
        if centre is None:
            return smooth(start, end, max(200, round(np.linalg.norm(end - start) / 0.2 * 1e3)))
        far_m, vias = 0.06, [start]
        first, last = ((p - centre) / max(np.linalg.norm(p - centre), 1e-9) for p in (start, end))
        if first @ last < 0.9:
            side = np.cross(first, self._rng.normal(size=3))
            side /= np.linalg.norm(side)
            middle = first + last if first @ last > -0.9 else side
            vias += [centre + far_m * way / np.linalg.norm(way) for way in (first, middle, last)]
        vias.append(end)
        return np.concatenate(
            [
                smooth(a, b, max(200, round(np.linalg.norm(b - a) / 0.2 * 1e3)))
                for a, b in zip(vias[:-1], vias[1:])
            ]
        )


# -- worlds ------------------------------------------------------------------------------------------------


def still(field: ForceField, **options: Any) -> World:
    """Return a world that does not change."""
    return World(HapticMedium.from_frames([field], 30.0), lambda tick: field, **options)


def desk() -> World:
    """Return the desk, looped."""
    spec = EncodeSpec(frames=(0, rests.FRAMES), nw=6)
    medium = rests.coded(str(SHARED / rests.SCENES["TUM desk"]), spec)
    surface = lambda tick: medium[min(rests.FRAMES - 1, round(tick * medium.rate_hz / 1e3))]  # noqa: E731
    return World(medium, surface, period=1e3 * rests.FRAMES / medium.rate_hz, every=134, is_static=False)


def bodies() -> World:
    """Return bodies that fall, looped; hands choose points of the voxels."""
    scene, _ = rests.falling()["objects"]
    voxels, _ = rests.falling()["voxels"]
    assert isinstance(voxels, HapticMedium)
    frames = len(voxels)
    speeds = np.zeros(frames)
    for body in getattr(scene, "objects", ()):
        positions, turns = body.track.positions_m, body.track.quaternions
        radius_m = max(np.ptp(np.array(body.medium.grid.box_m), axis=0)) / 2
        cosines = np.abs((turns[1:] * turns[:-1]).sum(axis=1)).clip(0, 1)
        moved_m = np.linalg.norm(np.diff(positions, axis=0), axis=1) + radius_m * 2 * np.arccos(cosines)
        speeds[1:] = np.maximum(speeds[1:], moved_m * voxels.rate_hz)
    near = np.maximum(speeds, np.maximum(np.roll(speeds, 1), np.roll(speeds, -1)))
    period = round(1e3 * frames / voxels.rate_hz)
    return World(
        scene, lambda tick: voxels[tick // 10], period=period, every=200,
        speeds_m_s=np.repeat(near, 10)[:period], is_static=False,
    )  # fmt: skip


def worlds() -> dict[str, Callable[[], World]]:
    """Return how to make each medium that the data allow."""
    plate = Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.001))
    found: dict[str, Callable[[], World]] = {
        "terrain": lambda: still(
            prepare("sample:terrain", EncodeSpec()).medium[0], friction=0.3, reach_m=(0.068, 0.05, 1.0)
        ),
        "ball": lambda: still(field_of(Sphere((0.0, 0.0, 0.0), 0.025)), friction=0.3, centre_m=np.zeros(3)),
        "plate 2 mm": lambda: still(field_of(plate), centre_m=np.zeros(3), reach_m=(0.022, 0.012, 1.0)),
        "falling bodies": bodies,
    }
    if (SHARED / rests.SCENES["TUM desk"]).is_dir():
        found["TUM desk"] = desk
    return found


# -- what they feel ----------------------------------------------------------------------------------------


def grown(values: Any) -> Any:
    """Return the largest value within `NEAR` ticks, of the same type, [hands, ticks]."""
    found = values
    for shift in range(1, NEAR + 1):
        found = np.maximum(found, np.pad(values, ((0, 0), (shift, 0)))[:, :-shift])
        found = np.maximum(found, np.pad(values, ((0, 0), (0, shift)))[:, shift:])
    return found


def explained_n(world: World, tick: int, runs: Runs, stiffness: float, beside: Any) -> tuple[Any, Any]:
    """Return what explains each step, with those beside and without, float64 [hands, ticks - 1]."""
    moved_m = np.diff(runs.position_m, axis=1)
    speeds_m = np.linalg.norm(moved_m, axis=2)
    changes_m = np.linalg.norm(np.diff(moved_m, axis=1, prepend=moved_m[:, :1]), axis=2)
    ticks = tick + 1 + np.arange(speeds_m.shape[1])
    if world.speeds_m_s is not None:
        speeds_m = speeds_m + 1e-3 * world.speeds_m_s[ticks % round(world.period)]
    sum_n_per_m = stiffness + STICK_N_PER_M * world.friction
    bound = sum_n_per_m * speeds_m + DAMPER_N_S_PER_M * 1e3 * changes_m
    is_edge = grown(np.linalg.norm(runs.field_n, axis=2)[:, 1:] < EDGE_N)
    bound = bound + np.where(is_edge, DAMPER_N_S_PER_M * 1e3 * speeds_m, 0.0)  # metres a tick
    allowed = np.full(len(ticks), ALLOWED_N)
    if world.period:
        is_fading = (ticks % world.period < FADE) & (ticks >= world.period)
        allowed = allowed + np.where(is_fading, FADE_STEP * LARGEST_N, 0.0)
    return RATIO * np.maximum(bound, grown(beside)) + allowed, RATIO * bound + allowed


def events(is_beyond: Any) -> int:
    """Count steps beyond a limit, bool [hands, ticks]; those within `APART` ticks are one."""
    count = 0
    for row in is_beyond:
        at = np.flatnonzero(row)
        count += len(at) and 1 + int((np.diff(at) > APART).sum())
    return count


def chatters(presses: list[Press], force_n: Any, beside_n: Any) -> tuple[int, int, float]:
    """Count quarters of a second of rest, those that chatter, and return the worst vibration, newtons rms."""
    count, loud, worst = 0, 0, 0.0
    for press in presses:
        start = press.start + 1000
        if press.stop - start < 2 * BAND_TICKS:
            continue
        row = slice(start, press.stop)
        bands = [in_band(forces[press.hand, row], 1000.0) for forces in (force_n, beside_n)]
        whole = len(bands[0]) // BAND_TICKS
        if not whole:
            continue
        rms = [
            np.sqrt((band[: whole * BAND_TICKS] ** 2).sum(axis=1).reshape(whole, -1).mean(axis=1))
            for band in bands
        ]
        count, worst = count + whole, max(worst, float(rms[0].max()))
        loud += int((rms[0] > np.maximum(CHATTER_N, RATIO * rms[1])).sum())
    return count, loud, worst


def given_way(presses: list[Press], runs: Any, stiffness: float) -> int:
    """Count presses at whose end the hand is behind the wall without a force."""
    count = 0
    for press in presses:
        row = slice(press.stop - 100, press.stop)
        depth_m = ((press.point_m - runs.position_m[press.hand, row]) @ press.normal).min()
        force_n = np.linalg.norm(runs.force_n[press.hand, row], axis=1).max()
        count += bool(depth_m > 1.5 * press.push_n / stiffness + 1e-3 and force_n < 0.3 * press.push_n)
    return count


def wander(world: World, minutes: float) -> Figures:
    """Let hands wander over a medium, and count."""
    wall = wall_of(world.surface(0))
    assert wall is not None
    stiffness, intents = wall.stiffness_n_per_m, Intents(world, SEED)
    crowd = {
        render: Hands(
            world.medium, loop=bool(world.period),
            spec=RenderSpec(render=render, up="lattice", friction=world.friction),
        )
        for render in ("auto", "field")
    }  # fmt: skip
    shadow = Hands(
        world.medium, loop=bool(world.period), spec=RenderSpec(render="field", up="lattice", friction=0.0)
    )

    def undamp(tick: int) -> None:
        """Leave the field as it is stored: the player sets the damper as soon as it knows a stiffness."""
        shadow.memory.receiver["settings"]["brake_n_s_per_m"] = 0.0

    row: Figures = dict.fromkeys(
        ("presses", "clicks", "jumps", "field_jumps", "rest_quarters", "chatter", "field_chatter"), 0
    )
    row |= {"gave_way": 0, "field_gave_way": 0, "worst_click_mn": 0.0, "worst_rest_mn": 0.0}
    for part in range(max(1, round(60e3 * minutes / HANDS / PART_TICKS))):
        goals, presses = intents.part(part * PART_TICKS, stiffness)
        runs = {render: hands.run(goals, PART_TICKS, SPRING) for render, hands in crowd.items()}
        beside = shadow.run(runs["auto"].position_m, PART_TICKS, on_chunk=undamp)
        auto, field = runs["auto"], runs["field"]
        with_beside, alone = explained_n(world, part * PART_TICKS, auto, stiffness, beside.steps_n)
        _, of_field = explained_n(world, part * PART_TICKS, field, stiffness, beside.steps_n)
        steps = auto.steps_n
        row["clicks"] += events(steps > with_beside)
        row["worst_click_mn"] = max(
            row["worst_click_mn"], 1e3 * float(np.where(steps > with_beside, steps, 0).max())
        )
        row["jumps"] += events(steps > alone)
        row["field_jumps"] += events(field.steps_n > of_field)
        quarters, loud, worst = chatters(presses, auto.force_n, beside.force_n)
        row["field_chatter"] += chatters(presses, field.force_n, 0 * beside.force_n)[1]
        row["rest_quarters"], row["chatter"] = row["rest_quarters"] + quarters, row["chatter"] + loud
        row["worst_rest_mn"] = max(row["worst_rest_mn"], 1e3 * worst)
        row["presses"] += len(presses)
        row["gave_way"] += given_way(presses, auto, stiffness)
        row["field_gave_way"] += given_way(presses, field, stiffness)
    return row | {"hours": HANDS * PART_TICKS * max(1, round(60e3 * minutes / HANDS / PART_TICKS)) / 3.6e6}


def measure(minutes: float) -> Figures:
    """Let hands wander over all media."""
    rows = {}
    for name, make in worlds().items():
        rows[name] = wander(make(), minutes)
    return {"rows": rows, "static": [name for name in rows if name not in ("TUM desk", "falling bodies")]}


def bars(figures: Figures) -> list[Bar]:
    """Require no clicks, no chatter, and walls that hold."""
    found = []
    for name, row in figures["rows"].items():
        found.append(at_most(f"{name}: clicks in {row['hours']:.2g} h", row["clicks"], 0))
        found.append(at_most(f"{name}: quarters of a second of chatter at rest", row["chatter"], 0))
        is_static = name in figures["static"]
        limit = 0 if is_static else row["field_gave_way"]
        found.append(at_most(f"{name}: presses to which the wall gave way", row["gave_way"], limit))
    return found


if __name__ == "__main__":
    bench("hour", __doc__, measure, bars, minutes=(60, 7))
