"""Counts what a column of table 1 needs of one scene: samples, entropies and bits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from reproduction.later_frames import LaterFrames, consecutive_runs, later_frames
from reproduction.lattice_sample import LatticeSample, sample_lattice
from reproduction.section_5_1 import READINGS
from touchfield.medium import Grid, HapticMedium

if TYPE_CHECKING:
    from collections.abc import Sequence

    from reproduction.perceptual_bits import PerceptualFilter
    from reproduction.progress import Steps
    from reproduction.section_5_1 import PaperScene

__all__ = ["MASK_K", "NW", "STEPS", "SceneCounts", "counts_of"]

MASK_K: Final = 0.1
"""Of the mask in which later frames are held: the middle one of the paper's table 3."""

NW: Final = 7
"""Later frames are counted whole, on 2^7 samples along each axis of the workspace."""

STEPS: Final = 5
"""Parts that `counts_of` reports."""

_SIDE = 96  # samples along each axis of the scene's box, for the worst error


@dataclass(frozen=True)
class SceneCounts:
    """What was counted of one scene.

    Attributes
    ----------
    scene : PaperScene
    nominal, on_device : dict of str to LatticeSample
        For each reading.
    by_volume : dict of (str, bool) to float, or None
        Of a scene of bodies, for each reading and whether it is the nominal lattice: their volume in cells.
    later : dict of (str, str) to LaterFrames
        For each reading and quantiser.
    worst : dict of str to float
        For each quantiser the worst relative error of forces of F_0 and more.
    """

    scene: PaperScene
    nominal: dict[str, LatticeSample]
    on_device: dict[str, LatticeSample]
    by_volume: dict[tuple[str, bool], float] | None
    later: dict[tuple[str, str], LaterFrames]
    worst: dict[str, float]


def counts_of(
    scene: PaperScene, filters: Sequence[PerceptualFilter], steps: Steps, quick: bool
) -> SceneCounts:
    """Count one scene; `quick` with fewer samples."""
    from touchfield.pipeline.spec import DEFAULT_F0_N

    per_axis, starts = (32, 8) if quick else (128, 16)
    symbols = {one.text: one.symbols_of for one in filters}

    def sampled(reading: str, is_nominal: bool) -> LatticeSample:
        with steps.step() as report:
            return sample_lattice(
                lambda part: scene.field(0, part), scene.lattice(reading, is_nominal), symbols,
                per_axis=per_axis, starts=starts, report=report,
            )  # fmt: skip

    nominal = {reading: sampled(reading, True) for reading in READINGS}
    on_device = {reading: sampled(reading, False) for reading in READINGS}
    with steps.step() as report:
        # of depth maps from one to the next: where one begins, unknown pixels come and go
        asked = (2, 2) if quick else (4, scene.cycle_frames or 40)
        runs = consecutive_runs(scene.scene.frame_count, *asked)
        later = later_frames(
            _medium(scene).__getitem__, runs, {one.text: one for one in filters}, MASK_K, report
        )
    low, high = scene.scene.bounds_m()
    forces = scene.field(0, Grid.over_box(low, high, (_SIDE, _SIDE, _SIDE)))
    vectors = forces.forces_n[forces.mask]
    worst = {one.text: one.worst_error(vectors, DEFAULT_F0_N) for one in filters}
    return SceneCounts(scene, nominal, on_device, _by_volume(scene), later, worst)


def _by_volume(scene: PaperScene) -> dict[tuple[str, bool], float] | None:
    volume = scene.volume_m3()
    if volume is None:
        return None
    lattices = {
        (r, is_nominal): scene.lattice(r, is_nominal) for r in READINGS for is_nominal in (True, False)
    }
    return {key: volume / float(np.prod(grid.spacing_m)) for key, grid in lattices.items()}


def _medium(scene: PaperScene) -> HapticMedium:
    """The scene through the device filter, 2^7 samples along each axis of the workspace."""
    from touchfield.pipeline.preparation import prepare
    from touchfield.pipeline.spec import EncodeSpec

    return prepare(scene.scene, EncodeSpec(nw=NW, mapping="fill")).medium
