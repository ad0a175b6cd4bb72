"""Compiling every kernel before it is needed: those of the main job, of the haptic filters and of the measures."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from touchfield.codec.touch.spec import TouchSpec
from touchfield.filters.registry import field_filters
from touchfield.job.compare import compare
from touchfield.job.encode import encode
from touchfield.job.measure import MeasureSpec, measure_medium
from touchfield.job.play import PlaySpec, play
from touchfield.job.prepare import prepare
from touchfield.job.spec import EncodeSpec, Report, silent
from touchfield.render.sampler import FieldSampler

__all__ = ["warm_up"]


def warm_up(report: Report = silent) -> None:
    """Compile and cache every kernel by running what there is on tiny scenes."""
    from touchfield.sources.samples import tiny_scenes

    scenes = tiny_scenes()
    specs = [EncodeSpec(nw=3), EncodeSpec(device="tshirt-32x32")]
    jobs = [(scene, specs[0]) for scene in scenes] + [(scenes[0], specs[1])]
    jobs += [(scenes[-1], EncodeSpec(nw=3, representation="voxel", surface_damping_n_s_per_m=1.0))]
    jobs += [(scenes[1], EncodeSpec(nw=4, touch=asked)) for asked in (TouchSpec(), TouchSpec(mode="nmse"))]
    filters = list(field_filters().values())
    total = len(jobs) + len(filters) + 2
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "warm.touch"
        for i, (scene, spec) in enumerate(jobs):
            encode(scene, target, spec)
            compare(scene, target)
            report(i + 1, total)
        play(target, PlaySpec(offline=True, seconds=0.1))
    medium = prepare(scenes[0], EncodeSpec(nw=4)).medium
    for i, kind in enumerate(filters):
        kind.parse(kind.example)(medium[0])
        report(len(jobs) + i + 1, total)
    measure_medium(medium, MeasureSpec(devices=("tshirt-32x32",)))
    report(total - 1, total)
    FieldSampler(medium).force_n(0.0, np.zeros((2, 3)))
    report(total, total)
