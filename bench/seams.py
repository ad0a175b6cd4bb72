"""Steps of the force where a medium does not continue: the end of a loop, a seek, the start of a segment,
late frames, another layer of a stream.

Bodies fall and come to rest (`sample:falling-7`, 100 frames a second), as objects and as coded voxels. Hands
rest at seeded points in the last frames, where the force is 0.6 to 2.2 N, fixed or on a spring (0.2 kg,
200 N/m, 2 N s/m), while the player plays these cases (`cases`), rendered by the field and by the player's
choice ("auto"):

* loop, seek, segment: a seek in contact, the start of a segment, and the end of a loop, whereupon the bodies
  are elsewhere; then the fixed hand goes back into contact by a seek.
* loops: three ends of a loop.
* seeks: 20 to seeded times, forward and back, whose frames come after 0 to 60 ms; "slow" and "fast": eight of
  them at the speeds 0.5 and 2.
* again: each of five seeks is followed by two others, which interrupt its fade.
* pause: a pause, a seek meanwhile, and playback from there on.
* late: frames that come up to 60 ms late.
* layer: a live stream that changes between its layers: each second 0.15 s have half the resolution.

A step is |F| of the change from one tick of 1 ms to the next, mN. "field_own" is the largest one of the field
while the whole medium plays once, without a seam, at half and at twice the speed "field_slow" and
"field_fast"; "band" is the part of the force from 40 to 400 Hz around the end of the loop, mN rms. "beside"
is the field where the hands on springs of "auto" are: after a seek these swing into walls that hands on
springs of the field do not reach.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import touchfield as tf
from machine import Bar, Figures, at_most
from touchfield.codec.touch.spec import TouchSpec
from touchfield.filters.resample import pyramid, rebuild_level
from touchfield.medium import ForceField, HapticMedium, HapticScene
from touchfield.perception.hand_motion import in_band
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.sampler import FieldSampler
from touchfield.render.spec import RenderSpec
from touchfield.sources.options import SourceOptions

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "render"))
from seam_makers import SPRING_N_PER_M, Played, steps_n

LEAST_N, MOST_N = 0.6, 2.2
END_S, RATE_HZ, AROUND_MS = 2.0, 100.0, (3, 140)
LATE, MAX_RATIO = 12, 2.0
LAYER_FRAMES = 15
"""Frames of a layer before the other one follows."""
MIN_CASE_POINTS = 6
"""Of the hands that rest; the cases beyond the first take a quarter of them, and no fewer than these."""


@dataclass(frozen=True)
class Case:
    """A session: where it starts, what happens, and at which ticks there are seams of which kind."""

    start_s: float
    ticks: int
    events: dict[int, float | Callable[[Played], None]]
    seams: dict[str, list[int]]
    late: int = LATE
    speed: float = 1.0
    is_layered: bool = False
    own: str = "field_own"
    is_loop: bool = True


def first_case(is_spring: bool) -> Case:
    """Return a seek in contact, a segment that starts, the end of a loop, and a fixed hand's second seek."""
    seek, back_s, again = 250, 1.25, 1300
    segment, loop = (round(seek + LATE + 1e3 * (time_s - back_s)) for time_s in (1.5, END_S))
    events: dict[int, Any] = {seek: back_s} if is_spring else {seek: back_s, again: 1.8}
    return Case(1.2, 1600, events, {"loop": [loop], "seek": [*events], "segment": [segment]})


def seek_case(name: str, count: int, speed: float, late: tuple[int, ...]) -> Case:
    """Return seeks to seeded times, each in reach of a whole fade."""
    rng, ticks = np.random.default_rng(7), 200 + 220 * np.arange(count)
    events: dict[int, Any] = {}
    for n, (tick, time_s) in enumerate(zip(ticks.tolist(), rng.uniform(0.0, END_S, count), strict=True)):
        events[tick] = seek_to(float(time_s), late[n % len(late)])
    own = {1.0: "field_own", 0.5: "field_slow", 2.0: "field_fast"}[speed]
    return Case(1.6, int(ticks[-1]) + 200, events, {name: ticks.tolist()}, speed=speed, own=own)


def seek_to(time_s: float, late: int) -> Callable[[Played], None]:
    """Return a seek, the frames of which come `late` ticks after it."""

    def seek(played: Played) -> None:
        played.late = late
        played.seek(time_s)

    return seek


def cases() -> list[Case]:
    """Return all cases but the first."""
    rng = np.random.default_rng(8)
    again: dict[int, Any] = {}
    pause: dict[int, Any] = {}
    for tick in range(200, 200 + 5 * 320, 320):
        for lag, time_s in zip((0, 40, 75), rng.uniform(1.0, END_S, 3).tolist(), strict=True):
            again[tick + lag] = time_s
        pause |= {tick: Played.pause, tick + 30: float(rng.uniform(1.0, END_S)), tick + 90: Played.play}
    late: dict[int, Any] = {
        tick: lambda played, n=n: played.hold_back_frames(50 + 12 * n)
        for n, tick in enumerate(range(100, 100 + 5 * 250, 250))
    }
    changes = range(LAYER_FRAMES, round(END_S * RATE_HZ), LAYER_FRAMES)
    starts = [round(1e3 * frame / RATE_HZ) - 1000 for frame in changes if frame > RATE_HZ]
    loops = [300, 2300, 4300]
    return [
        Case(1.7, loops[-1] + 150, {}, {"loops": loops}),
        seek_case("seeks", 20, 1.0, (12, 0, 60)),
        seek_case("slow", 8, 0.5, (12,)),
        seek_case("fast", 8, 2.0, (12,)),
        Case(1.5, 1800, again, {"again": [*again]}),
        Case(1.5, 1800, pause, {"pause": [*pause]}),
        Case(0.7, 1300, late, {"late": [tick + n for tick in late for n in (40, 100)]}),
        Case(1.0, 1000, {}, {"layer": starts}, is_layered=True, is_loop=False),
    ]


@dataclass(frozen=True)
class Layers:
    """Frames of a stream that changes between its layers; the first frames of each are marked."""

    fine: HapticMedium
    coarse: dict[int, ForceField] = field(default_factory=dict)

    def __call__(self, frame: int) -> ForceField:
        fine: ForceField = self.fine[frame]
        if frame // LAYER_FRAMES % 2 == 0:
            return fine
        if frame not in self.coarse:
            self.coarse[frame] = rebuild_level(pyramid(fine, 1)[1], fine.grid)
        return self.coarse[frame]

    @staticmethod
    def is_seam(frame: int) -> bool:
        """Return whether another layer starts with a frame."""
        return frame % LAYER_FRAMES == 0


def media(nw: int) -> dict[str, HapticMedium | HapticScene]:
    """Return the falling bodies as objects, and as coded voxels."""
    spec = EncodeSpec(nw=nw, source=SourceOptions(rate_hz=RATE_HZ), touch=TouchSpec(effort="fast"))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "voxels.touch"
        tf.encode("sample:falling-7", path, replace(spec, representation="voxel"))
        voxels = tf.decode(path)
        held = HapticMedium.from_frames([*voxels], voxels.rate_hz, voxels.axes)
        held = replace(held, segments=voxels.segments)
    scene = prepare("sample:falling-7", replace(spec, representation="object")).objects
    assert scene is not None
    return {"objects": scene, "voxels": held}


def resting_points(medium: HapticMedium | HapticScene, count: int) -> list[tuple[Any, Any]]:
    """Return seeded points in contact in the last frames, and the forces there, each float64 [3]."""
    low, high = medium.grid.box_m
    points = np.random.default_rng(1).uniform(low, high, (200_000, 3))
    forces = FieldSampler(medium).force_n(END_S - 0.05, points).astype(np.float64)
    sizes = np.linalg.norm(forces, axis=1)
    found = np.flatnonzero((sizes > LEAST_N) & (sizes < MOST_N))[:count]
    return [*zip(points[found], forces[found], strict=True)]


def session(medium: Any, case: Case, render: str) -> Played:
    """Return the session of a case before its first tick."""
    spec = RenderSpec(render=render, up="lattice", blend=bool(case.seams))
    return Played(medium, case.late, spec=spec, start_s=case.start_s, loop=case.is_loop, speed=case.speed)


def rest(medium: Any, hand: tuple[Any, Any], case: Case, is_spring: bool, render: str) -> tuple[Any, Any]:
    """Return the forces on a hand at rest, newtons, and its positions, metres, float64 [ticks, 3] each."""
    played, (point, force) = session(medium, case, render), hand
    if is_spring:
        goal_m = point - force / SPRING_N_PER_M
        forces_n, positions_m = played.on_spring(point, goal_m, case.ticks, case.events)
        return forces_n, positions_m
    return played.at_rest(point, case.ticks, case.events), np.broadcast_to(point, (case.ticks, 3))


def beside_n(medium: Any, positions_m: Any, case: Case) -> Any:
    """Return the force of the field along the way of a hand, float64 [ticks, 3], newtons."""
    played, rows = session(medium, case, "field"), []
    for tick, position_m in enumerate(positions_m):
        played.happen(case.events.get(tick))
        rows.append(played.tick(position_m))
    return np.array(rows)


def around(tick: int) -> slice:
    """Return the ticks around a seam."""
    before, after = AROUND_MS
    return slice(tick - before, tick + after)


def own_step_n(medium: Any, hand: tuple[Any, Any], is_spring: bool, speed: float) -> float:
    """Return the largest step of the field while the medium plays once, after the first ticks, newtons."""
    whole = Case(0.0, round(1e3 * END_S / speed), {}, {}, speed=speed, is_loop=False)
    return float(steps_n(rest(medium, hand, whole, is_spring, "field")[0])[AROUND_MS[1] :].max())


def felt_at_seams(forces_n: Any, case: Case) -> Figures:
    """Return the largest step at each kind of seam of a case, mN, and the band around the end of the loop."""
    steps = 1e3 * steps_n(forces_n)
    row: Figures = {
        key: max(float(steps[around(tick)].max()) for tick in ticks) for key, ticks in case.seams.items()
    }
    if "loop" in case.seams:
        band = in_band(forces_n, 1000.0)
        band = band[around(case.seams["loop"][0] - (len(forces_n) - len(band)) // 2)]
        row["band"] = 1e3 * float(np.sqrt((band**2).sum(axis=1).mean()))
    return row


def worst_of(rows: list[Figures]) -> Figures:
    """Return the largest of each figure."""
    return {key: max(row[key] for row in rows) for key in rows[0]}


def worst_steps(medium: Any, hands: list[Any], case: Case, is_spring: bool) -> dict[str, Figures]:
    """Return what hands feel at the seams of a case at worst: of the field, "auto", and beside springs."""
    found: dict[str, list[Figures]] = {render: [] for render in ("field", "auto", *["beside"] * is_spring)}
    for hand in hands:
        found["field"].append(felt_at_seams(rest(medium, hand, case, is_spring, "field")[0], case))
        forces_n, positions_m = rest(medium, hand, case, is_spring, "auto")
        found["auto"].append(felt_at_seams(forces_n, case))
        if is_spring:
            found["beside"].append(felt_at_seams(beside_n(medium, positions_m, case), case))
    return {render: worst_of(rows) for render, rows in found.items()}


def seams(points: int, nw: int = 6) -> Figures:
    """Measure the steps at seams, and of the field elsewhere."""
    rows: Figures = {}
    for name, medium in media(nw).items():
        hands = resting_points(medium, points)
        some = hands[: max(len(hands) // 4, MIN_CASE_POINTS)]
        for is_spring in (False, True):
            speeds = {"field_own": 1.0, "field_slow": 0.5, "field_fast": 2.0}
            own = {
                key: 1e3 * max(own_step_n(medium, hand, is_spring, speed) for hand in hands)
                for key, speed in speeds.items()
            }
            by_render = worst_steps(medium, hands, first_case(is_spring), is_spring)
            for case in cases():
                played: Any = medium
                if case.is_layered:
                    if not isinstance(medium, HapticMedium):
                        continue
                    played = replace(medium, make_frame=Layers(medium), segments=None)
                for render, row in worst_steps(played, some, case, is_spring).items():
                    by_render[render] |= row
            for render, row in by_render.items():
                rows[f"{name}, {'spring' if is_spring else 'fixed'}, {render}"] = row | own
    return rows


def bars(rows: Figures) -> list[Bar]:
    """Require that "auto" steps at a seam by at most twice as much as the field does, there or without one.

    A hand on a spring swings after a seam, faster than in a medium that plays once, and elsewhere than one
    that the field holds: so the field beside it counts, too.
    """
    own = {"slow": "field_slow", "fast": "field_fast"}
    found = []
    for name, row in rows.items():
        hand, _, render = name.rpartition(", ")
        if render == "beside":
            continue
        beside = rows.get(f"{hand}, beside", {})
        for kind in [key for key in row if key != "band" and not key.startswith("field_")]:
            allowed = row[own.get(kind, "field_own")]
            if render == "auto":
                allowed = max(allowed, rows[f"{hand}, field"][kind], beside.get(kind, 0.0))
            found.append(at_most(f"{name}: step at {kind} over the field's", row[kind] / allowed, MAX_RATIO))
    return found
