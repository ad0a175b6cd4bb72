"""Compiling every kernel before it is needed: those of the main job, of the haptic filters and of the measures."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.touch.warm import GROUPS as TOUCH
from touchfield.codec.touch.warm import solid
from touchfield.filters.registry import field_filters
from touchfield.job.compare import compare
from touchfield.job.encode import encode
from touchfield.job.measure import MeasureSpec, measure_medium
from touchfield.job.play import PlaySpec, play
from touchfield.job.spec import EncodeSpec, Report, silent
from touchfield.medium import HapticMedium
from touchfield.render.sampler import FieldSampler

__all__ = ["GROUPS", "warm_up"]


def _filters() -> None:
    for kind in field_filters().values():
        kind.parse(kind.example)(solid())


def _measures() -> None:
    medium = HapticMedium.from_frames([solid()] * 2, 30.0)
    measure_medium(medium, MeasureSpec(devices=("tshirt-32x32",)))
    FieldSampler(medium).force_n(0.0, np.zeros((2, 3)))


GROUPS: Final[Mapping[str, Callable[[], None]]] = {**TOUCH, "filters": _filters, "measures": _measures}
"""Kernels that are compiled together, each by a small job."""


def warm_up(report: Report = silent) -> None:
    """Compile and cache every kernel by running what there is on tiny scenes."""
    from touchfield.sources.samples import tiny_scenes

    scenes = tiny_scenes()
    jobs = [(scene, EncodeSpec(nw=3)) for scene in scenes]
    jobs += [(scenes[0], EncodeSpec(device="tshirt-32x32"))]
    jobs += [(scenes[-1], EncodeSpec(nw=3, representation="voxel", surface_damping_n_s_per_m=1.0))]
    jobs += [(scenes[1], EncodeSpec(nw=4, touch=asked)) for asked in (TouchSpec(), TouchSpec(mode="nmse"))]
    total = len(jobs) + len(GROUPS)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "warm.touch"
        for i, (scene, spec) in enumerate(jobs):
            encode(scene, target, spec)
            compare(scene, target)
            report(i + 1, total)
        play(target, PlaySpec(offline=True, seconds=0.1)).checked()
    for i, group in enumerate(GROUPS.values()):
        group()
        report(len(jobs) + i + 1, total)
