"""Table 1 of the paper: sizes, entropies and bits of two scenes for a point device (section 5.1).

Every lattice of the paper is counted at its own size, and none is allocated: by systematic samples of it
(`touchfield.measure.stratified`), by looking at every sample of the device's lattice a slab at a time where the scene
is of bodies, and by the volume of bodies with a formula.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from touchfield.devices import device
from touchfield.experiments.experiment import Experiment, Finding, Inputs, markdown_table
from touchfield.experiments.later_frames import LaterFrames, consecutive_runs, later_frames
from touchfield.experiments.perceptual_bits import PerceptualFilter, six_and_twelve, three_times_six
from touchfield.experiments.printed_tables import PRINTED_1, identity_table
from touchfield.experiments.section_5_1 import READINGS, PaperScene, scenes
from touchfield.experiments.table_wording import Steps, bits, capacity_words, count, counted
from touchfield.job.prepare import prepare
from touchfield.job.spec import DEFAULT_F0_N, EncodeSpec
from touchfield.measure.stratified import LatticeSample, sample_lattice

__all__ = ["EXPERIMENT", "SceneCounts", "counts_of", "run"]

MASK_K: Final = 0.1
"""Of the mask in which later frames are held: the default of the paper's section 5.2."""

RAW_BITS: Final = 3 * np.dtype(np.float32).itemsize * 8

_NW: Final = 7


@dataclass(frozen=True)
class SceneCounts:
    """What was counted of one scene.

    Attributes
    ----------
    scene : PaperScene
    nominal, on_device : dict
        For each reading.
    exact : int or None
        Of a scene of bodies: samples of the device's lattice with a force, all looked at; *corrected*.
    volume_counts : dict or None
        For each reading: the bodies' volume in cells of the nominal lattice.
    later : dict
        For each reading and quantiser.
    worst : dict
        For each quantiser the worst relative error, of forces above its F_min and above F_0.
    """

    scene: PaperScene
    nominal: dict[str, LatticeSample]
    on_device: dict[str, LatticeSample]
    exact: int | None
    volume_counts: dict[str, float] | None
    later: dict[tuple[str, str], LaterFrames]
    worst: dict[str, tuple[float, float]]


def run(inputs: Inputs) -> Finding:
    """Table 1 for scene 1 with four and with seven bodies, and for scene 2."""
    force_max_n = device("phantom-omni").force_max_n
    filters = (three_times_six(force_max_n), six_and_twelve(force_max_n))
    found = []
    chosen = scenes(inputs)
    steps = Steps(inputs.report, 7 * len(chosen))
    for scene in chosen:
        found.append(counts_of(scene, filters, steps, inputs.quick))
    parts, data = [_introduction(filters, inputs.quick)], []
    for one in found:
        table, values = _scene_table(one, filters)
        parts.append(f"### {one.scene.title}\n\n{table}")
        data.append(values)
    checked, identities = identity_table(PRINTED_1, {"scene1": "Scene 1", "scene2": "Scene 2"}, "nominal")
    parts.append(_checks(checked))
    return Finding("\n\n".join(parts), {"scenes": data, "printed_identity": identities})


def counts_of(scene: PaperScene, filters: tuple[PerceptualFilter, ...], steps: Steps, quick: bool) -> SceneCounts:
    """Count one scene."""
    per_axis, starts = (32, 8) if quick else (128, 16)
    symbols = {one.words: one.symbols_of for one in filters}

    def sampled(reading: str, is_nominal: bool) -> LatticeSample:
        with steps.step() as report:
            return sample_lattice(
                lambda part: scene.field(0, part), scene.lattice(reading, is_nominal), symbols,
                per_axis=per_axis, starts=starts, report=report,
            )  # fmt: skip

    nominal = {reading: sampled(reading, True) for reading in READINGS}
    on_device = {reading: sampled(reading, False) for reading in READINGS}
    volume = scene.volume_m3()
    volumes = {r: volume / float(np.prod(scene.lattice(r, True).spacing_m)) for r in READINGS} if volume else None
    exact = None
    with steps.step() as report:
        if volume and not quick:
            exact = scene.counted(scene.lattice("corrected", False), report)
    with steps.step() as report:
        later = _later(scene, filters, report, quick)
    with steps.step():
        forces = scene.field(0, scene.lattice("literal", False).coarsened(32)) if False else None
    worst = {one.words: _worst(scene, one) for one in filters}
    return SceneCounts(scene, nominal, on_device, exact, volumes, later, worst)
