"""Steps of the force on a hand that rests on a medium that changes, of `auto`, the field and the source.

Hands rest at seeded points, scripted or on a spring (0.2 kg, 200 N/m, 2 N s/m). The media are:

* TUM desk, ICL room: 24 frames, coded and looped, on `--lattices` lattices from nw 6. Hands are pressed 3 mm
  behind the surface of the first frame.
* bodies at rest, bodies in motion: bodies that fall (`sample:falling-7`), as objects and as coded voxels,
  looped. Hands are where the force in the last frames, or at some time of the fall, is 0.6 to 2.2 N.
* terrain: `sample:terrain`, which does not change.
* live, live and coarse: the desk as a live stream in segments of 8 frames; of the latter every third segment
  is lost, and the coarse layer replaces it. That change is none of the source's.
* deformed: the terrain, moved to and fro by 2 mm by a deformation.

Each is rendered by the field and by the player's choice ("auto", a proxy), and the medium before coding by
the field ("source"). "step" is the largest change of the force from one tick of 1 ms to the next, mN, and
"band" its part from 40 to 400 Hz, mN rms, within windows: at rest, around the start of a segment, the end of
a loop, and a seek. Both are the worst of all points. "beside" is the field where the hands on springs of
"auto" are: those of the field settle elsewhere, often behind an edge or a wall. The device is a phantom-omni
without a continuous limit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import touchfield as tf
from hands import CHUNK, Hands, Runs, Spring
from live_offline import Arrivals, Layer, recorded
from machine import SHARED, Bar, Figures, at_most
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import HapticMedium, HapticScene
from touchfield.medium.deformation import Deformation
from touchfield.perception.hand_motion import in_band, points_on_surface
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.sampler import FieldSampler
from touchfield.render.spec import RenderSpec
from touchfield.sources.options import SourceOptions

SCENES = {"TUM desk": "rgbd_tum_fr1_rpy", "ICL room": "rgbd_iclnuim_livingroom1"}
FRAMES, LIVE_FRAMES, SEGMENT_FRAMES = 24, 90, 8
DEPTH_M, OUTSIDE_M, PRESS_S, QUIET = 0.003, 0.008, 0.1, 900
LEAST_N, MOST_N = 0.6, 2.2
LATE, BEFORE, AFTER = 12, 3, 140
"""Ticks until the frames of a seek come, and those before and after a seam that count as being around it."""
PAUSE, SETTLE = CHUNK, 125 * CHUNK
"""Ticks until a medium stands, and for how long, so that hands on springs come to rest."""
MAX_RATIO, LEAST_STEP_MN, LEAST_BAND_MN = 2.0, 5.0, 0.5
"""Of `auto` to the field; below these figures of the field nothing is compared."""

Medium = HapticMedium | HapticScene


@dataclass(frozen=True)
class Case:
    """Hands at rest on a medium.

    `goals_m` and `starts_m`, float64 [hands, ticks or 1, 3] and [hands, 3], are those of scripted hands and
    of hands on springs. `seams` are the ticks of each kind of seam; what is not around one is "rest".
    `arrivals` makes the stream of a medium that arrives while it plays. The medium stands from `PAUSE` on
    for `settle` ticks, in which hands on springs come to rest. A stream that loses segments, `is_lossy`, is
    compared with no source, which loses none.
    """

    name: str
    medium: Medium
    source: Medium | None
    goals_m: tuple[Any, Any]
    starts_m: Any
    ticks: int
    start_s: float = 0.0
    is_loop: bool = True
    quiet: int = QUIET
    seeks: Mapping[int, float] = field(default_factory=dict)
    seams: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    deformation: Deformation | None = None
    arrivals: Callable[[], Arrivals] | None = None
    settle: int = 0
    is_lossy: bool = False

    def run(self, is_spring: bool, render: str, goals_m: Any = None) -> Runs:
        """Render the hands; scripted ones may go through other goals, float64 [hands, ticks, 3]."""
        spec = RenderSpec(
            render="field" if render == "source" else render, up="lattice", deformation=self.deformation
        )
        goals_m = self.goals_m[is_spring] if goals_m is None else goals_m
        arrivals = None if self.arrivals is None else self.arrivals()
        medium = self.medium if arrivals is None else arrivals.medium
        if render == "source":
            assert self.source is not None
            medium, arrivals = self.source, None
        is_loop = self.is_loop or render == "source"
        crowd = Hands(medium, LATE, spec=spec, start_s=self.start_s, loop=is_loop)

        def happen(tick: int) -> None:
            if arrivals is not None:
                arrivals(tick)
            if self.settle and tick == PAUSE:
                crowd.played.pause()
            if self.settle and tick == PAUSE + self.settle:
                crowd.played.play()

        return crowd.run(
            goals_m, self.ticks, Spring() if is_spring else None, self.starts_m, self.seeks, happen
        )

    @property
    def windows(self) -> dict[str, Any]:
        """Return the steps of each kind, bool [ticks - 1]."""
        found = {"rest": np.arange(self.ticks - 1) >= self.quiet}
        for kind, ticks in self.seams.items():
            if not ticks:
                continue
            found[kind] = np.zeros(self.ticks - 1, np.bool_)
            for tick in ticks:
                found[kind][max(0, tick - BEFORE) : tick + AFTER] = True
            found["rest"] &= ~found[kind]
        return found


# -- media -------------------------------------------------------------------------------------------------


def held(medium: HapticMedium) -> HapticMedium:
    """Return a medium with all frames in memory."""
    return replace(medium, make_frame=[*medium].__getitem__)


def coded(source: str, spec: EncodeSpec) -> HapticMedium:
    """Return a source after coding."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scene.touch"
        tf.encode(source, path, spec)
        return held(tf.decode(path))


def pressed(medium: HapticMedium, points: int, ticks: int) -> tuple[Any, Any]:
    """Return goals of hands that are pressed behind points of the first frame, and their starts."""
    first = medium[0]
    points_m = points_on_surface(first, points, np.random.default_rng(5))
    normals = first.sample_n(points_m).astype(np.float64)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    starts, ends = points_m + OUTSIDE_M * normals, points_m - DEPTH_M * normals
    ways = np.clip(np.arange(ticks) / (1e3 * PRESS_S), 0.0, 1.0)[:, None]
    return starts[:, None] + ways * (ends - starts)[:, None], starts


def depth_case(name: str, nw: int, points: int) -> Case:
    """Return hands on a depth sequence: 24 frames of 0.8 s, in segments of half a second."""
    spec = EncodeSpec(frames=(0, FRAMES), nw=nw)
    folder = str(SHARED / SCENES[name])
    medium = coded(folder, spec)
    goals, starts = pressed(medium, points, 2600)
    seek, back_s, length_ms = 1900, 0.3, 1e3 * FRAMES / medium.rate_hz
    assert medium.segments is not None
    segments_ms = [1e3 * first / medium.rate_hz for first in medium.segments.starts[1:]]
    return Case(
        f"{name}, nw {nw}", medium, held(prepare(folder, spec).medium), (goals, goals), starts, 2600,
        seeks={seek: back_s},
        seams={
            "segment": tuple(round(length_ms + segment_ms) for segment_ms in segments_ms),
            "loop": (round(2 * length_ms), seek + LATE + round(length_ms - 1e3 * back_s)),
            "seek": (seek,),
        },
    )  # fmt: skip


@cache
def falling() -> dict[str, tuple[Medium, Medium]]:
    """Return the falling bodies as objects and as coded voxels, each with its source."""
    spec = EncodeSpec(nw=6, source=SourceOptions(rate_hz=100.0), touch=TouchSpec(effort="fast"))
    voxel = replace(spec, representation="voxel")
    scene = prepare("sample:falling-7", replace(spec, representation="object")).objects
    assert scene is not None
    uncoded = held(prepare("sample:falling-7", voxel).medium)
    return {"objects": (scene, scene), "voxels": (coded("sample:falling-7", voxel), uncoded)}


def touched(medium: Medium, times_s: Any, points: int, seed: int) -> tuple[Any, Any]:
    """Return seeded points in contact at one of the times, and the forces there, float64 [points, 3] each."""
    rng, sampler = np.random.default_rng(seed), FieldSampler(medium)
    low, high = medium.grid.box_m
    found: list[Any] = []
    each = -(-points // len(times_s))
    for time_s in times_s:
        places = rng.uniform(low, high, (100_000, 3))
        forces = sampler.force_n(float(time_s), places).astype(np.float64)
        sizes = np.linalg.norm(forces, axis=1)
        chosen = np.flatnonzero((sizes > LEAST_N) & (sizes < MOST_N))[:each]
        found.append(np.concatenate([places[chosen], forces[chosen]], axis=1))
    rows = np.concatenate(found)[:points]
    return rows[:, :3], rows[:, 3:]


def falling_cases(points: int) -> Iterator[Case]:
    """Yield hands on bodies that have come to rest, and in the way of bodies that fall."""
    for kind, (medium, source) in falling().items():
        segments = getattr(medium, "segments", None)
        segments_s = () if segments is None else tuple(first / 100.0 for first in segments.starts[1:])
        places, forces = touched(medium, [1.95], points, 1)
        ends = places - forces / Spring().n_per_m
        start_s, seek, back_s = 1.3, SETTLE + 400, 1.6
        yield Case(
            f"bodies at rest, {kind}", medium, source, (places[:, None], ends[:, None]), places, SETTLE + 952,
            start_s=start_s, settle=SETTLE, quiet=SETTLE, seeks={seek: back_s},
            seams={
                "segment": tuple(
                    SETTLE + round(1e3 * (s - start_s)) for s in segments_s if start_s < s < back_s
                ),
                "seek": (seek,),
                "loop": (seek + LATE + round(1e3 * (2.0 - back_s)),),
            },
        )  # fmt: skip
        places, forces = touched(medium, np.linspace(0.1, 1.2, 12), points, 2)
        yield Case(
            f"bodies in motion, {kind}", medium, source, (places[:, None], places[:, None]), places, 2600,
            quiet=130,
            seams={"segment": tuple(round(1e3 * s) for s in segments_s), "loop": (2000,)},
        )  # fmt: skip


def terrain_cases(points: int) -> Iterator[Case]:
    """Yield hands on the terrain, which does not change, and on one that is deformed to and fro."""
    medium = held(prepare("sample:terrain", EncodeSpec()).medium)
    goals, starts = pressed(medium, points, 1600)
    yield Case("terrain", medium, medium, (goals, goals), starts, 1600)
    low, high = (np.asarray(corner) for corner in medium.grid.box_m)
    lift = np.zeros((60, 4, 4, 4, 3))
    lift[..., 1] = 0.002 * np.sin(2 * np.pi * np.arange(60) / 60)[:, None, None, None]
    deformation = Deformation(lift, tuple(low), tuple(high - low), 60.0)
    yield Case("deformed", medium, medium, (goals, goals), starts, 1600, deformation=deformation)


@cache
def desk_stream() -> tuple[HapticMedium, tuple[Layer, Layer]]:
    """Return the desk, and its broadcast."""
    spec = EncodeSpec(frames=(0, FRAMES), nw=6)
    medium = held(prepare(str(SHARED / SCENES["TUM desk"]), spec).medium)
    return medium, recorded(medium, spec, LIVE_FRAMES, SEGMENT_FRAMES)


def live_cases(points: int) -> Iterator[Case]:
    """Yield hands on the desk as a live stream, whole and with every third segment coarse."""
    medium, (fine, coarse) = desk_stream()
    segment_s = SEGMENT_FRAMES / medium.rate_hz
    goals, starts = pressed(medium, points, 2600)
    starts_ms = [round(1e3 * segment_s * n) for n in range(1, round(2.4 / segment_s) + 1)]
    loops = tuple(starts_ms[n - 1] for n in (3, 6, 9) if 800 < starts_ms[n - 1] < 2400)
    others = tuple(tick for tick in starts_ms if tick > QUIET and tick not in loops)
    for name, layer, lost in (("live", None, range(0)), ("live and coarse", coarse, range(1, 99, 3))):
        yield Case(
            name, medium, medium, (goals, goals), starts, 2600, is_loop=False,
            seams={"segment": others, "loop": loops},
            arrivals=partial(Arrivals, fine, layer, lost, segment_s), is_lossy=bool(lost),
        )  # fmt: skip


def cases(points: int, lattices: int) -> Iterator[Case]:
    """Yield all cases that the data allow."""
    for name, folder in SCENES.items():
        if (SHARED / folder).is_dir():
            yield from (depth_case(name, nw, points) for nw in range(6, 6 + lattices))
    yield from falling_cases(points)
    yield from terrain_cases(points)
    if (SHARED / SCENES["TUM desk"]).is_dir():
        yield from live_cases(points)


# -- figures -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Felt:
    """What hands felt in the windows of a case: float64 [hands], mN, and the ticks of the worst steps."""

    steps_mn: dict[str, Any]
    bands_mn: dict[str, Any]
    ticks: dict[str, Any]


def felt(case: Case, forces_n: Any) -> Felt:
    """Return the largest steps and the vibration in each window."""
    steps = 1e3 * np.linalg.norm(np.diff(forces_n, axis=1), axis=2)
    bands = [in_band(forces, 1000.0) for forces in forces_n]
    cut = (forces_n.shape[1] - len(bands[0])) // 2
    powers = np.array([(band**2).sum(axis=1) for band in bands])
    found = Felt({}, {}, {})
    for kind, is_within in case.windows.items():
        masked = np.where(is_within, steps, 0.0)
        found.steps_mn[kind], found.ticks[kind] = masked.max(axis=1), masked.argmax(axis=1)
        inner = np.flatnonzero(is_within[cut : cut + powers.shape[1]])
        found.bands_mn[kind] = 1e3 * np.sqrt(powers[:, inner].mean(axis=1))
    return found


RENDERS = ("source", "field", "auto")
KINDS = {False: "scripted", True: "spring"}


def measured(case: Case) -> dict[bool, dict[str, Felt]]:
    """Measure a case, for scripted hands and for those on springs."""
    found: dict[bool, dict[str, Felt]] = {}
    for is_spring in KINDS:
        runs = {render: case.run(is_spring, render) for render in RENDERS[case.is_lossy :]}
        if is_spring:
            runs["beside"] = case.run(False, "field", runs["auto"].position_m)
        found[is_spring] = {render: felt(case, run.force_n) for render, run in runs.items()}
    return found


def rows_of(case: Case, found: dict[bool, dict[str, Felt]]) -> Figures:
    """Return the worst of all points, mN, a row for each kind of hand and window."""
    rows: Figures = {}
    for is_spring, by_render in found.items():
        for kind in case.windows:
            row: Figures = {"points": len(case.starts_m)}
            for render, one in by_render.items():
                row[f"{render}_step"] = float(one.steps_mn[kind].max())
                row[f"{render}_band"] = float(one.bands_mn[kind].max())
            rows[f"{case.name}, {KINDS[is_spring]}, {kind}"] = row
    return rows


def rests(points: int, lattices: int) -> Figures:
    """Measure hands at rest on the media that are there, on `lattices` lattices from nw 6."""
    rows: Figures = {}
    for case in cases(points, lattices):
        rows |= rows_of(case, measured(case))
    return rows


def ratios(row: Figures) -> dict[str, float]:
    """Return `auto` over the field of step and vibration.

    That is the less steady one of the field, or the source if that is steadier, and the field beside.
    """
    found = {}
    for key, least in (("step", LEAST_STEP_MN), ("band", LEAST_BAND_MN)):
        steadier = min(row[f"field_{key}"], row.get(f"source_{key}", np.inf))
        found[key] = row[f"auto_{key}"] / max(steadier, row.get(f"beside_{key}", 0.0), least)
    return found


def bars(rows: Figures) -> list[Bar]:
    """Require that `auto` steps and hums by at most twice as much as field and source, in every window."""
    worst: dict[tuple[str, str], float] = {}
    for name, row in rows.items():
        for key, ratio in ratios(row).items():
            case = name.rpartition(", ")[0], key
            worst[case] = max(worst.get(case, 0.0), ratio)
    return [
        at_most(f"{name}: {key} of auto over the field's and the source's", ratio, MAX_RATIO)
        for (name, key), ratio in worst.items()
    ]
