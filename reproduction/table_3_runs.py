"""Codes one depth sequence with every setting of table 3, and measures what makes its frames differ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from reproduction.coding import Coded, CodedScene
from reproduction.scenes import DepthInput, NoisyPair, inverse_depth_noise_per_m
from reproduction.trends import Case
from touchfield.codec.paper.spec import PaperSpec

if TYPE_CHECKING:
    from touchfield.sources.scene import Scene

__all__ = [
    "DIRECTIONS",
    "MOVING",
    "NOISE",
    "READINGS",
    "Cause",
    "Runs",
    "SequenceRuns",
    "Settings",
    "run_sequence",
    "run_variant",
    "steps",
]

READINGS: Final = ("literal", "corrected")

DIRECTIONS: Final = {"literal": {True: "octa3", False: "ico3"}, "corrected": {True: "ico5", False: "ico3"}}
"""High and low direction codebook: 258 is the paper's count, 252 the icosahedron's nearest; 92 is one in
both.
"""


STILL, NOISE, MOVING = "still view, the same frame twice", "still view, noise of the sensor", "moving camera"
"""Circumstances of a `Cause`; the last is followed by the coordinates."""


@dataclass(frozen=True)
class Settings:
    """What the paper leaves open or varies.

    Attributes
    ----------
    nw, nq : int
        n_w and n_q, which the paper does not state for table 3.
    fractions : tuple of float
        k.
    frame_counts : tuple of int
        m.
    """

    nw: int
    nq: int
    fractions: tuple[float, ...]
    frame_counts: tuple[int, ...]

    @property
    def cases(self) -> list[Case]:
        """All settings of the table."""
        return [Case(m, k, high) for m in self.frame_counts for k in self.fractions for high in (True, False)]

    def paper(self, reading: str, k: float, is_high: bool) -> PaperSpec:
        """The coder of a reading."""
        directions = DIRECTIONS[reading][is_high]
        if reading == "literal":
            return PaperSpec.literal(k=k, nq=self.nq, directions=directions)
        return PaperSpec(k=k, nq=self.nq, directions=directions)


@dataclass(frozen=True)
class Runs:
    """All settings on one sequence, made a force field in one way.

    Attributes
    ----------
    variant : str
        How the depth became forces.
    coded : dict
        By reading and case.
    floors_db : dict
        By reading and fineness: the NMSE of quantising alone, nothing held; 10 log NMSE of one frame.
    support_share : float
        L over the voxels, first frame.
    """

    variant: str
    coded: dict[str, dict[Case, Coded]]
    floors_db: dict[str, dict[bool, float]]
    support_share: float


@dataclass(frozen=True)
class Cause:
    """What a second frame costs under one circumstance.

    Attributes
    ----------
    circumstance : str
    resent : dict
        By k: share of the second frame's voxels that are sent, corrected reading, always the difference.
    cost : dict
        By reading and k: bits of the second frame over those of the first, differences alone.
    """

    circumstance: str
    resent: dict[float, float]
    cost: dict[str, dict[float, float]]


@dataclass(frozen=True)
class SequenceRuns:
    """A depth sequence: its variants, and the causes of its changes.

    Attributes
    ----------
    name : str
    notes : tuple of str
    noise_mm : float
        Standard deviation of the noise at the median depth, as the first frame shows it.
    """

    name: str
    size_px: tuple[int, int]
    notes: tuple[str, ...]
    noise_mm: float
    variants: tuple[Runs, ...]
    causes: tuple[Cause, ...]


def steps(settings: Settings, has_poses: bool) -> int:
    """How often `run_sequence` calls its ``step``."""
    variants, causes = (3, 4) if has_poses else (2, 3)
    if max(settings.frame_counts) == 1:
        causes = 0
    return variants * 2 * (2 + len(settings.cases)) + causes * 2 * len(settings.fractions)


def run_sequence(one: DepthInput, settings: Settings, step: Callable[[], None]) -> SequenceRuns:
    """Code every setting of one depth sequence.

    Parameters
    ----------
    one : DepthInput
        Cut to as many frames as the largest m.
    settings : Settings
    step : callable
        Called after each file that was coded.
    """
    from touchfield.sources.depth.depth_scene import DepthScene
    from touchfield.sources.terrain.height_scene import HeightScene

    sequence = one.first(max(settings.frame_counts)).sequence
    walls: dict[str, Scene] = {"wall, camera": DepthScene(sequence, frame="camera")}
    if sequence.poses is not None:
        walls = {"wall, world": DepthScene(sequence, frame="world"), **walls}
    scenes = {**walls, "solid, camera": HeightScene.from_depth_sequence(sequence, 1.0)}
    coded = {variant: CodedScene(scene, settings.nw) for variant, scene in scenes.items()}
    depth = sequence.depth_m(0)
    noise_per_m = inverse_depth_noise_per_m(depth)
    still = {
        STILL: CodedScene(DepthScene(NoisyPair(sequence, 0.0), "camera"), settings.nw),
        NOISE: CodedScene(DepthScene(NoisyPair(sequence, noise_per_m)), settings.nw),
    }
    moving = {f"{MOVING}, {v.partition(', ')[2]} coordinates": coded[v] for v in walls}
    median_m = float(np.median(depth[depth > 0])) if (depth > 0).any() else 0.0
    return SequenceRuns(
        one.name,
        (sequence.width, sequence.height),
        tuple(note.replace(sequence.name, one.name) for note in sequence.notes),
        1e3 * noise_per_m * median_m**2,
        tuple(run_variant(variant, scene, settings, step) for variant, scene in coded.items()),
        tuple(_cause(name, scene, settings, step) for name, scene in {**still, **moving}.items())
        if max(settings.frame_counts) > 1
        else (),
    )


def run_variant(variant: str, scene: CodedScene, settings: Settings, step: Callable[[], None]) -> Runs:
    """Code every setting of one scene."""
    coded: dict[str, dict[Case, Coded]] = {reading: {} for reading in READINGS}
    floors: dict[str, dict[bool, float]] = {reading: {} for reading in READINGS}
    for reading in READINGS:
        for is_high in (True, False):
            alone = PaperSpec(
                nq=settings.nq, directions=DIRECTIONS[reading][is_high], deadband="none", interframe="none"
            )
            floors[reading][is_high] = scene.coded(alone).nmse_db
            step()
        for case in settings.cases:
            coded[reading][case] = scene.coded(settings.paper(reading, case.k, case.is_high), case.m)
            step()
    first = scene.fields[0]
    return Runs(variant, coded, floors, first.support_count / first.grid.voxel_count)


def _cause(circumstance: str, scene: CodedScene, settings: Settings, step: Callable[[], None]) -> Cause:
    resent: dict[float, float] = {}
    cost: dict[str, dict[float, float]] = {reading: {} for reading in READINGS}
    for k in settings.fractions:
        for reading in READINGS:
            spec = settings.paper(reading, k, True)
            if reading == "corrected":
                spec = PaperSpec(k=k, nq=settings.nq, directions=spec.directions, choose_by_size=False)
            two = scene.coded(spec, 2)
            cost[reading][k] = two.bits(1) / two.bits(0) if two.bits(0) else 0.0
            if reading == "corrected":
                resent[k] = two.frames[1].sent / max(1, two.frames[1].supported)
            step()
    return Cause(circumstance, resent, cost)
